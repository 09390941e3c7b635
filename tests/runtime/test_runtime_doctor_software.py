"""What the doctor says of packages, the simulator, Docker and keys."""

import base64
import json
import os
import sys
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry, PrivateKey, format_key
from hapticnet.runtime.doctor.engine import examine_engine
from hapticnet.runtime.doctor.finding import Verdict
from hapticnet.runtime.doctor.keys import KeyFiles, examine_keys
from hapticnet.runtime.doctor.machine import Machine, Ran
from hapticnet.runtime.doctor.simulator import examine_simulator, judge_simulator, judge_tools
from hapticnet.runtime.doctor.software import (
    EXTRAS,
    LOOP,
    PACKAGES,
    Package,
    examine_software,
    judge_extra,
    judge_loop,
    judge_packages,
    judge_python,
    parse_imports,
)
from hapticnet.runtime.simavr import BUILD_VARIABLE

OK, WARNING, PROBLEM, ABSENT = Verdict.OK, Verdict.WARNING, Verdict.PROBLEM, Verdict.ABSENT
PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
OWN, OTHER = PrivateKey(bytes(range(32))), PrivateKey(bytes(range(1, 33)))


def command(finding):
    return finding.to_do[0].command


def named(requirement):
    return requirement.partition(";")[0].partition(">")[0].strip()


def test_every_dependency_is_looked_at():
    assert {*PACKAGES, LOOP} == {named(each) for each in PROJECT["dependencies"]}
    extras = {name: [named(each) for each in PROJECT["optional-dependencies"][name]] for name in EXTRAS}
    assert extras == {name: [package] for name, (package, _) in EXTRAS.items()}


def test_the_packages_of_this_environment_can_be_imported():
    findings = {finding.topic.name: finding for finding in examine_software(Machine())}
    assert findings["packages"].verdict is OK
    assert findings["python"].verdict is OK
    assert findings["loop"].value.startswith("uvloop ")


def test_a_package_that_brings_python_down_is_named():
    lines = [{"package": "msgpack", "started": True}, {"package": "msgpack", "version": "1.1", "error": None}]
    lines += [{"package": "numpy", "started": True}]
    out = "\n".join(["a greeting", "[1]", *map(json.dumps, lines)])
    packages = parse_imports(Ran(-4, out, ""))
    assert packages == {"msgpack": Package("1.1"), "numpy": Package(None, "Python ended with code -4")}
    finding = judge_packages({"msgpack": packages["msgpack"], "numpy": packages["numpy"], "rich": Package(None)})
    assert finding.verdict is PROBLEM
    assert finding.value == "numpy: Python ended with code -4; rich: missing"
    assert command(finding).endswith("-m pip install --force-reinstall numpy rich")
    assert "no end after" in parse_imports(Ran(None, json.dumps(lines[0]), ""))["msgpack"].error


def test_the_event_loop_and_extras():
    assert judge_loop(Package("0.21")).verdict is OK
    assert judge_loop(Package(None)).verdict is WARNING
    assert "broken: ImportError" in judge_loop(Package(None, "ImportError: x")).value
    assert judge_extra("fast", Package("0.61")).verdict is OK
    assert judge_extra("fast", Package(None)).verdict is ABSENT
    assert judge_extra("fast", Package(None, "ImportError: numpy is too new")).verdict is WARNING


@pytest.mark.parametrize(
    ("version", "implementation", "debug", "verdict"),
    [
        ((3, 11, 0), "CPython", False, OK),
        ((3, 10, 9), "CPython", False, PROBLEM),
        ((3, 11, 9), "PyPy", False, WARNING),
        ((3, 13, 0), "CPython", True, WARNING),
    ],
)
def test_the_interpreter(version, implementation, debug, verdict):
    assert judge_python(version, implementation, debug=debug).verdict is verdict


def test_a_simulator_is_missed_only_by_who_uses_it(monkeypatch, tmp_path):
    monkeypatch.setenv(BUILD_VARIABLE, str(tmp_path))
    empty = Machine(root=tmp_path, environ={"PATH": str(tmp_path)})
    simulator, tools = examine_simulator(empty)
    assert (simulator.verdict, tools.verdict) == (ABSENT, ABSENT)
    assert command(tools) == "sudo apt-get install gcc-avr libsimavr-dev libelf-dev avr-libc"
    assert examine_simulator(empty, wanted=True)[0].verdict is PROBLEM
    (tmp_path / "firmware-500000.elf").touch()
    (tmp_path / "harness").write_text("not a program")
    (tmp_path / "harness").chmod(0o755)
    broken = examine_simulator(empty)[0]
    assert broken.verdict is PROBLEM
    assert "cannot start" in broken.value
    assert judge_simulator(None, built=True, wanted=True).verdict is OK
    assert judge_tools([]).verdict is OK


@pytest.fixture
def docker(tmp_path):
    """Return the findings with a program that stands for docker."""

    def examine(script):
        program = tmp_path / "docker"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        return examine_engine(Machine(root=tmp_path, environ={"PATH": f"{tmp_path}"}))

    return examine


def test_no_docker_is_no_problem(tmp_path):
    (finding,) = examine_engine(Machine(root=tmp_path, environ={"PATH": str(tmp_path)}))
    assert finding.verdict is ABSENT


@pytest.mark.parametrize(
    ("script", "value", "advice"),
    [
        (
            "echo 'permission denied while trying to connect' >&2; exit 1",
            "permission denied",
            "sudo usermod -aG docker $USER",
        ),
        ("echo 'Cannot connect to the Docker daemon' >&2; exit 1", "not running", "sudo systemctl start docker"),
        ("echo 'a new kind of error' >&2; exit 1", "a new kind of error", "docker version"),
        ("exit 3", "'docker version' ended with code 3", "docker version"),
    ],
)
def test_an_engine_that_does_not_answer_says_what_helps(docker, script, value, advice):
    engine, compose = docker(script)
    assert (engine.verdict, engine.value, command(engine)) == (WARNING, value, advice)
    assert compose.verdict is ABSENT


def test_an_engine_that_answers_is_fine(docker):
    engine, compose = docker("echo 28.2.2")
    assert (engine.verdict, engine.value, compose.verdict) == (OK, "28.2.2 answers", OK)


def test_an_engine_that_hangs_is_given_up(docker, monkeypatch):
    monkeypatch.setattr("hapticnet.runtime.doctor.engine.ANSWER_WITHIN_S", 0.2)
    engine, _ = docker("exec /bin/sleep 60")
    assert (engine.verdict, engine.value) == (WARNING, "does not answer within 0.2 s")
    assert command(engine) == "sudo systemctl restart docker"


def test_a_program_that_leaves_children_behind_is_given_up():
    ran = Machine().run(["/bin/sh", "-c", "sleep 60 & echo said; sleep 60"], 0.2)
    assert ran.code is None
    assert "said" in ran.out


@pytest.fixture
def keys(tmp_path):
    """Return the findings about keys, by name."""
    tmp_path.chmod(0o700)

    def examine(**keywords):
        return {finding.topic.name: finding for finding in examine_keys(KeyFiles(**keywords))}

    return examine


def test_no_keys_are_no_problem_until_somebody_names_them(keys, tmp_path):
    usual, masters = tmp_path / "key.toml", tmp_path / "masters.toml"
    assert {each.verdict for each in keys(key=usual, masters=masters).values()} == {ABSENT}
    assert {each.verdict for each in keys().values()} == {ABSENT}
    missing = keys(key=usual, key_named=True, masters=masters, masters_named=True)
    assert {each.verdict for each in missing.values()} == {PROBLEM}
    assert command(missing["key"]) == f"hapticnet key new {usual}"


def test_a_good_key_shows_its_public_half_only(keys, tmp_path):
    write_key(tmp_path / "key.toml", OWN)
    finding = keys(key=tmp_path / "key.toml")["key"]
    assert finding.verdict is OK
    assert format_key(OWN.public) in finding.value
    secret = base64.b64encode(OWN.private).decode()
    assert secret not in json.dumps(finding.as_json())


def test_a_key_that_others_can_read_or_replace_is_named(keys, tmp_path):
    path = tmp_path / "key.toml"
    write_key(path, OWN)
    tmp_path.chmod(0o770)
    replaceable = keys(key=path)["key"]
    assert (replaceable.verdict, command(replaceable)) == (WARNING, f"chmod go-w {tmp_path}")
    tmp_path.chmod(0o777)
    refused = keys(key=path)["key"]
    assert (refused.verdict, command(refused)) == (PROBLEM, f"chmod o-w {tmp_path}")
    tmp_path.chmod(0o700)
    path.chmod(0o644)
    readable = keys(key=path)["key"]
    assert (readable.verdict, command(readable)) == (PROBLEM, f"chmod 600 {path}")


def test_a_broken_key_does_not_show_what_is_in_it(keys, tmp_path):
    path = tmp_path / "key.toml"
    path.write_text('private = "c2VjcmV0"\n')
    path.chmod(0o600)
    finding = keys(key=path)["key"]
    assert finding.verdict is PROBLEM
    assert "c2VjcmV0" not in json.dumps(finding.as_json())


def test_the_list_of_masters_is_read(keys, tmp_path):
    path = tmp_path / "masters.toml"
    path.write_text("")
    assert keys(masters=path)["masters"].verdict is WARNING
    path.write_text(dump_master(MasterEntry(name="theatre 2", public=OTHER.public, scene="paper:1")))
    assert keys(masters=path)["masters"].value == f"1 in {path}: theatre 2"
    (tmp_path / "own.toml").write_bytes((files("hapticnet.scene") / "presets" / "example-viscous.toml").read_bytes())
    path.write_text(dump_master(MasterEntry(name="theatre 2", public=OTHER.public, scene="own.toml")))
    assert keys(masters=path)["masters"].verdict is OK, "relative to the list"
    path.write_text(dump_master(MasterEntry(name="theatre 2", public=OTHER.public, scene="nowhere.toml")))
    lost = keys(masters=path)["masters"]
    assert lost.verdict is PROBLEM
    assert "scene of master 'theatre 2'" in lost.value
    path.write_text("[[master]]\nname = 3\n")
    assert keys(masters=path)["masters"].verdict is PROBLEM


def test_the_slaves_public_key_is_checked(keys, tmp_path):
    write_key(tmp_path / "key.toml", OWN)
    assert keys(peer=format_key(OTHER.public))["peer"].verdict is OK
    for text in ("", "rubbish", format_key(bytes(32))):
        assert keys(peer=text)["peer"].verdict is PROBLEM
    own = keys(key=tmp_path / "key.toml", peer=format_key(OWN.public))["peer"]
    assert own.verdict is PROBLEM
    assert "the master's own" in own.value


def test_a_key_that_this_account_cannot_read_is_named(keys, tmp_path, monkeypatch):
    path = tmp_path / "key.toml"
    path.write_text("")
    path.chmod(0o600)
    monkeypatch.setattr(os, "access", lambda *_: False)  # root, who runs tests in CI, can read everything
    assert command(keys(key=path)["key"]) == f"sudo chown $USER {path}"


def test_the_interpreter_in_commands_is_this_one():
    assert sys.executable in command(judge_extra("fast", Package(None)))
