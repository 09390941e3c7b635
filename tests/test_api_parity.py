"""Python and the command line agree: the same defaults, the same fields of reports."""

import inspect
import json
from collections.abc import Sequence

import numpy as np
import pytest
import typer

import hapticnet as hn
from hapticnet.cli import app
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION
from tests.ready import hapticnet

ANY_PORT = "127.0.0.1:0"
LAW = {"weber": "weber_fraction", "floor": "floor_n"}
OF_A_PROCESS = {"duration", "metrics", "real_time", "json", "report", "quiet", "config"}
OF_A_FILE = {
    "force_column": "columns", "time_column": "time", "position_column": "position", "sampling_rate": "rate_hz",
    "max_size": "max_bytes",
}  # fmt: skip

CASES = {
    "master": (
        (hn.Master, hn.ThreadedMaster, hn.TickedMaster),
        {
            **LAW, "connect": "address", "rate": "rate_hz", "max_age": "max_age_s",
            "record_limit": "record_limit_bytes", "connect_timeout": "connect_timeout_s",
        },
        # The hand, the law of a participant's file, the page and emulated networks are what a program makes itself.
        {*OF_A_PROCESS, "insertions", "law", "channel_out", "channel_in", "page", "seed"},
        {"start", "on_error"},
        # A program gives the positions, takes the force, and is told soon if there is no slave.
        {"operator", "device", "connect_timeout"},
    ),
    "slave": (
        (hn.Slave, hn.ThreadedSlave, hn.TickedSlave),
        {"keep": "keep_s", "fastest_rate": "fastest_rate_hz", "add_codec": "codecs"},
        {*OF_A_PROCESS, "drain", "channel_out", "seed", "record_dir", "record_format", "record_limit"},
        {"on_error"},
        set(),
    ),
    "compare": (
        (hn.compare, hn.load_recording),
        {**LAW, **OF_A_FILE, "traces": "force", "delay": "delay_ms"},
        {
            "scene", "start", "json", "csv", "plot_dir", "plot_format", "overwrite",
        },
        {"path", "t_s", "t_us"},
        {"jobs"},  # further processes would import the program
    ),
}  # fmt: skip


def plain(value):
    """Return a default as one number or text, whatever form a person writes it in."""
    if isinstance(value, str) and value[:1].isdigit() and ":" not in value:
        value = tuple(float(part) for part in value.removesuffix("ms").split(","))
    if isinstance(value, Sequence) and not isinstance(value, str):
        value = value[0] if len(value) == 1 else tuple(value) or None
    return None if value is False else value


def defaults_of(*functions):
    found = {}
    for function in functions:
        for name, parameter in inspect.signature(function).parameters.items():
            default = parameter.default
            found.setdefault(name, () if repr(default) == "<factory>" else default)
    return found


@pytest.mark.parametrize("verb", CASES)
def test_options_and_parameters_have_the_same_defaults(verb):
    functions, renamed, only_options, only_parameters, meant = CASES[verb]
    options = {option.name: option.default for option in typer.main.get_command(app).commands[verb].params}
    parameters = defaults_of(*functions)
    mapped = {name: renamed.get(name, name) for name in options.keys() - only_options}
    assert set(mapped.values()) == parameters.keys() - only_parameters, "each has its counterpart, or is listed above"
    usual = {"weber_fraction": PAPER_WEBER_FRACTION, "floor_n": PAPER_FLOOR_N, "multiplier": 1.0}
    for option, parameter in mapped.items():
        in_python = parameters[parameter]
        if in_python is None or in_python is inspect.Parameter.empty:
            in_python = usual.get(parameter)
        if option not in meant:
            assert plain(options[option]) == plain(in_python), f"--{option} and {parameter}"


@pytest.mark.parametrize("kind", ["Master", "Slave"])
def test_all_ways_to_run_a_node_have_the_same_parameters(kind):
    ways = [inspect.signature(getattr(hn, prefix + kind)) for prefix in ("", "Threaded", "Ticked")]
    assert ways[0].parameters == ways[1].parameters == ways[2].parameters


def fields(account, prefix=""):
    """Return the names of all fields of a report, of those inside others too."""
    found = set()
    for name, value in account.items():
        found.add(f"{prefix}{name}")
        # What is inside depends on the run: what came of each kind of datagram, the operator, the device.
        if isinstance(value, dict) and name not in ("by_kind", "parameters", "step_times"):
            found |= fields(value, f"{prefix}{name}.")
        if isinstance(value, list) and value and isinstance(value[0], dict):
            found |= fields(value[0], f"{prefix}{name}.")
    return found


@pytest.fixture(scope="module")
def by_command(tmp_path_factory):
    """Return the reports of a master and a slave from the command line, and of the slave that was a program's."""
    folder = tmp_path_factory.mktemp("reports")
    with hn.ThreadedSlave("paper:1", listen=ANY_PORT) as slave:
        arguments = ("--device", "sim", "--duration", "0.3", "--no-real-time", "--report", folder / "master.json")
        done = hapticnet("master", "--connect", slave.address, *arguments)
        assert done.returncode == 0, done.stderr
        of_slave = slave.report()
    return json.loads((folder / "master.json").read_text()), of_slave


def ticked(address):
    master = hn.TickedMaster(address, device="sim", start=0.0)
    while not master.report()["ticks"] or master.report()["received"]["packets"] < 9:
        master.tick(0.0)
    report = master.report()
    master.close()
    return report


def test_the_report_of_a_master_has_the_fields_that_the_command_prints(by_command, tmp_path):
    with hn.ThreadedSlave("paper:1", listen=ANY_PORT) as slave:
        with hn.ThreadedMaster(slave.address, record=tmp_path / "run.csv") as master:
            master.exchange(0.0)
        recorded = master.report()["recording"]
        assert recorded["stopped"] is None
        assert "sessions_not_recorded" in recorded
        with hn.ThreadedMaster(slave.address, device="sim") as master:
            for _ in range(20):
                master.exchange(0.0)
            running = master.report()
        assert fields(running) == fields(master.report()) == fields(by_command[0])
        assert running["end_reason"] is None
        assert running["lateness"]["count"] > 0
        assert json.loads(json.dumps(running)) == running, "it is JSON"
        assert fields(ticked(slave.address)) == fields(by_command[0])


def test_the_report_of_a_slave_has_the_fields_that_the_command_prints(by_command):
    done = hapticnet("slave", "--listen", ANY_PORT, "--duration", "0.2", "--no-real-time", "--json")
    printed = json.loads(done.stdout)
    of_program = by_command[1]
    assert of_program["sessions"], "a master was there"
    assert {name for name in fields(of_program) if not name.startswith("sessions.")} == fields(printed)
    slave = hn.TickedSlave(listen=ANY_PORT)
    assert fields(slave.report()) == fields(printed)
    slave.close()


@pytest.fixture
def file(tmp_path):
    t_s = np.arange(2000) / 1000
    np.savetxt(tmp_path / "force.csv", np.column_stack([t_s, 2 + np.sin(t_s)]), delimiter=",", header="t_s,force_n")
    return tmp_path / "force.csv"


def test_a_comparison_has_the_rows_that_the_command_prints(file):
    arguments = ("--codecs", "deadband;raw", "--multipliers", "2", "--loss", "5%", "--json")
    printed = json.loads(hapticnet("compare", file, *arguments).stdout)
    force = {"force": hn.load_recording(file)}
    rows = [row.flat() for row in hn.compare(force, codecs=["deadband", "raw"], multipliers=2.0, loss=0.05)]
    for row, own in zip(printed["rows"], json.loads(json.dumps(rows)), strict=True):
        del row["nanoseconds_per_sample"], own["nanoseconds_per_sample"]  # the speed of this machine
        assert row == own
