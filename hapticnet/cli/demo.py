"""``hapticnet demo``: the paper's experiment on this machine, in about a minute."""

import os
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.experiment.analysis import Condition

OPEN_IT: Final = "open this address in a browser; press Ctrl-C to end"
Row: TypeAlias = dict[str, Any]

RESULTS = Path("results/demo")

SHOWN = "1 JND"
"""The condition of the figure of a run."""


def demo(
    seed: options.Seed = 1,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE", help="Scene that is touched, such as phantom; default: the paper's, of the seed."
        ),
    ] = None,
    insertions: Annotated[int, typer.Option(min=1, help="Insertions, or palpations, per condition.")] = 2,
    device: options.Device = "sim",
    codec: options.Codec = "deadband",
    announced: Annotated[
        bool,
        typer.Option(help="Let the slave announce the contact ahead, so that the device reacts in time."),
    ] = False,
    rate: Annotated[float, typer.Option(help="Positions a second.")] = 1000.0,
    page: options.Page = None,
    out_dir: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for figures, JSON and recordings; default: results/demo, or the next free -N."
        ),
    ] = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Play the paper's four conditions with a slave and a master process on loopback, and compare them.

    The picture bytes_per_penetration.png is the paper's Fig. 4.

    With --page, move the needle yourself in a browser instead, until Ctrl-C; nothing is written then.
    """
    import json as json_module
    import signal
    import sys

    from hapticnet.cli.console import Console, check_new, check_outputs, write_text
    from hapticnet.codec.registry import make_codec, parse_codec
    from hapticnet.errors import SettingsError, UnavailableError
    from hapticnet.experiment.analysis import CONDITIONS
    from hapticnet.experiment.demo import disturbances, draw_bytes_per_penetration, play_conditions, results
    from hapticnet.experiment.provenance import provenance
    from hapticnet.experiment.signal_figure import draw_run
    from hapticnet.files import fresh_path
    from hapticnet.perception import WeberLaw
    from hapticnet.runtime.devices import check_device
    from hapticnet.runtime.nano import simavr_build
    from hapticnet.scene.settings import BodySceneSettings
    from hapticnet.scene.sources import find_scene

    name, parameters = parse_codec(codec)
    make_codec(name, WeberLaw(), parameters)  # refuse it before anything is played
    check_device(device)
    if device.startswith("simavr"):
        simavr_build()
    if page is not None:
        if json or out_dir is not None:
            raise SettingsError("--page is played live and writes no results; omit --out-dir and --json")
        signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
        scene = scene or f"paper:{seed}"
        axes = getattr(find_scene(scene), "axes", 1)
        _play_on_page(
            page, Console("demo", quiet=quiet), scene, axes, seed=seed, device=device, codec=codec, rate_hz=rate
        )
        return
    out = fresh_path(RESULTS) if out_dir is None else out_dir
    report, bytes_figure, run_figure = (out / name for name in ("demo.json", "bytes_per_penetration.png", "run.png"))
    check_outputs(report, bytes_figure, run_figure)
    check_new(report, bytes_figure, run_figure, overwrite=overwrite)
    # Python does not clean up on SIGTERM by default; exiting this way ends the two processes first.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    console = Console("demo", quiet=quiet)
    scene = scene or f"paper:{seed}"
    found = find_scene(scene)
    bodies = isinstance(found, BodySceneSettings)
    what = "palpation" if bodies else "insertion"
    console.say(f"{found.name}, {insertions} {what}{'s' if insertions > 1 else ''}, felt four ways; about a minute")
    told: set[str] = set()

    def on_progress(condition: "Condition", seconds: float) -> None:
        if condition.name not in told:
            told.add(condition.name)
            console.say(f"condition {len(told)} of {len(CONDITIONS)}: {condition.name}")
        console.status(f"{condition.name}: {seconds:.0f} s")

    played = play_conditions(
        out,
        scene=scene,
        axes=found.axes if isinstance(found, BodySceneSettings) else 1,
        codec=codec,
        seed=seed,
        insertions=insertions,
        device=device,
        rate_hz=rate,
        announced=announced,
        on_progress=on_progress,
    )
    console.finish()
    disturbed = disturbances(played)
    if disturbed is not None:
        console.warn(f"delays and tracking may be worse than the system's own: {disturbed}")
    rows = results(played, found)
    settings = {
        "scene": scene,
        "seed": seed,
        "insertions": insertions,
        "rate_hz": rate,
        "device": device,
        "codec": codec,
        "announced": announced,
    }
    text = json_module.dumps({"provenance": provenance(), **settings, "conditions": rows}, indent=2)
    write_text(report, text + "\n")
    print(text) if json else print_results(rows)
    try:
        draw_bytes_per_penetration(rows, bytes_figure)
        shown = next(each for each in played if each.condition.name == SHOWN)
        draw_run(shown.slave_samples, shown.master_samples, run_figure, codec=f"{codec}, {SHOWN}")
    except UnavailableError as error:
        console.say(str(error))
    else:
        console.say(f"figures: {bytes_figure}, {run_figure}")
    console.say(f"all numbers: {report}")


def _play_on_page(
    page: str, console: "Console", scene: str, axes: int, *, seed: int, device: str, codec: str, rate_hz: float
) -> None:
    """Run both processes, open the page, and pass on the master's messages, until it ends.

    The browser is a child of this process, which has normal priority; a child of the master would inherit its
    real-time priority.
    """
    from hapticnet.cli.pages import PAGE, address_in
    from hapticnet.codec.registry import split_codec
    from hapticnet.options import AUTO
    from hapticnet.runtime.processes import Child

    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", scene, "--add-codec", split_codec(codec)[0]])
    master: Child | None = None
    try:
        arguments = ["master", "--connect", slave.address(), "--name", "demo", "--seed", str(seed)]
        arguments += ["--operator", f"page:axes={axes}"]
        arguments += ["--page" if page == AUTO else f"--page={page}", "--device", device]
        master = Child([*arguments, "--codec", codec, "--rate", str(rate_hz)])
        for line in master.lines():
            file, said = address_in(line.partition(": ")[2])
            console.say(said, needed=bool(file))
            if said.startswith(PAGE):
                console.say("press Ctrl-C to end" if open_browser(file) else OPEN_IT)
        master.finish()
    except KeyboardInterrupt:  # the normal end
        console.say("ended")
    finally:
        for child in (master, slave):
            if child is not None:
                child.end()


def open_browser(url: str) -> bool:
    """Open a page if there is a browser with a window; return whether there is one.

    All users of this machine can read the command line of a browser, so the address must have no token.
    """
    if not any(os.environ.get(name) for name in ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY")):
        return False
    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False


def print_results(rows: list[Row]) -> None:
    """Print the results of the conditions on stdout, with the paper's figures."""
    from hapticnet.experiment.table import print_table

    counted, lines = rows[0]["counted"], []
    for label, cell in _LINES:
        if counted == "penetration" or not label.strip().startswith("paper"):
            lines.append([label.replace("penetration", counted), *map(cell, rows)])
        if label == "  standard deviation":
            for tissue in rows[0]["bytes_of_each_tissue"]:
                means = [_of_tissue(row, tissue["tissue"]) for row in rows]
                lines.append([f"  {tissue['tissue']} ({tissue['breach_force_n']:g} N)", *means])
    print("Four conditions, the same motion")
    print_table(["", *(row["condition"] for row in rows)], lines)
    print((_PAPER if counted == "penetration" else "") + _FOOTNOTE.replace("penetration", counted))


def _of_tissue(row: Row, name: str) -> str:
    means = [tissue["mean"] for tissue in row["bytes_of_each_tissue"] if tissue["tissue"] == name]
    return f"{means[0]:,.0f}" if means else "–"


def _percent(value: float | None, sign: str = "") -> str:
    return "–" if value is None else f"{sign}{value:.1%}"


def _milliseconds(key: str, name: str) -> Callable[[Row], str]:
    def cell(row: Row) -> str:
        value = row[key][name]
        return "–" if value is None else f"{value / 1000:.2f} ms"

    return cell


def _reduction(row: Row) -> str:
    return "–" if row["codec"] == "raw" else _percent(row["byte_reduction"], "−")


def _paper_reduction(row: Row) -> str:
    if row["codec"] == "raw":
        return "–"
    return _percent(row["paper_byte_reduction"], "−") if row["paper_byte_reduction"] else "more"


def _tracking(row: Row) -> str:
    return "–" if row["tracking_rmse_n"] is None else f"{row['tracking_rmse_n']:.3f} N"


_PAPER = """\
Paper: "Cutaneous haptic deadband compression". It states neither its sampling
rate nor its motion, and the reduction grows with the rate: docs/benchmarks/tables.md
has the rate at which it is the paper's.
"""

_FOOTNOTE = """\
Bytes per penetration are those from the touch of a tissue to its breach, and
include keepalives and UDP and IPv4 headers. The standard deviation is
over all penetrations; lines below it are the means of each tissue, with its
breach force. The packet-rate reduction counts force packets only. "As felt"
compares the force held at each tick with the true force at the position of that
tick, so it includes the delay. "Over 25 ms" repeats this in virtual time, with
the recorded motion and that delay each way. "Energy created" is the energy that
the delayed force adds to the hand's motion, as a share of the work of the hand
against the true force. The device is late because its servos take a pulse every
20 ms and then need time to move; with --announced it knows of a breach in
advance (docs/use/device.md)."""

_LINES: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("samples", lambda row: f"{row['samples']:,}"),
    ("force packets", lambda row: f"{row['force_packets']:,}"),
    ("packet-rate reduction", lambda row: _percent(row["packet_rate_reduction"])),
    ("bytes per penetration", lambda row: f"{row['bytes_per_penetration']:,.0f}"),
    ("  standard deviation", lambda row: f"{row['bytes_deviation']:,.0f}"),
    ("  against none", _reduction),
    ("  paper", _paper_reduction),
    ("all bytes back, kB", lambda row: f"{row['feedback_wire_bytes'] / 1000:,.1f}"),
    ("  keepalives in them", lambda row: f"{row['keepalives']:,}"),
    ("paper: ordered right", lambda row: _percent(row["paper_correct"])),
    ("RMSE of the codec", lambda row: f"{row['rmse_n']:.4f} N"),
    ("largest error", lambda row: f"{row['max_error_n']:.4f} N"),
    ("exceed-JND fraction", lambda row: _percent(row["exceed_jnd_fraction"])),
    ("RMSE as felt", lambda row: f"{row['felt']['rmse_n']:.4f} N"),
    ("above 1 JND over 25 ms", lambda row: _percent(row["felt_over_link"]["exceed_jnd_fraction"])),
    ("  above 8 JND", lambda row: _percent(row["felt_over_link"]["above_8_jnd_fraction"])),
    ("  above 1 JND, predicted", lambda row: _percent(row["predicted_over_link"]["exceed_jnd_fraction"])),
    ("  energy created", lambda row: _percent(row["felt_over_link"]["created_share"])),
    ("device tracking RMSE", _tracking),
    ("round trip p50", _milliseconds("round_trip", "p50_us")),
    ("  p99", _milliseconds("round_trip", "p99_us")),
    ("  p99.9", _milliseconds("round_trip", "p99_9_us")),
    ("tick lateness p50", _milliseconds("lateness", "p50_us")),
    ("  p99", _milliseconds("lateness", "p99_us")),
    ("  p99.9", _milliseconds("lateness", "p99_9_us")),
    ("missed ticks", lambda row: f"{row['missed_ticks']}"),
)
