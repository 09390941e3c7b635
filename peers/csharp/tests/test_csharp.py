"""The C# binding under mono: examples, links in real time, Unity's life cycle with stand-ins, and the package."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from conformance.programs import (
    check_felt,
    check_refused,
    check_slave,
    codec_names,
    length_test,
    need,
    running_slave,
    taken_port,
    write_keys,
)
from conformance.session import SLAVE
from hapticnet.protocol.keys import format_key

HERE = Path(__file__).parents[1]
PACKAGE = HERE / "Hapticnet"
README = HERE / "README.md"
PROGRAMS = ("SmallestMaster", "SmallestSlave", "Life", "Steady", "Wrong")


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    need("mcs", "mono", "gcc", "make")
    folder = tmp_path_factory.mktemp("csharp")
    targets = [f"{folder}/{name}.exe" for name in PROGRAMS]
    done = subprocess.run(["make", "-s", "-C", HERE, f"BUILD={folder}", *targets], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr + done.stdout
    return folder


def run(folder, program, *arguments, **environment):
    """Return how a program ended, and what it wrote."""
    command = ["mono", f"{folder}/{program}.exe", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=os.environ | environment)


def check_life(said):
    """Check what a HapticMaster wrote that went 30 mm into the paper's scene and back, to the right of the world."""
    steps = [tuple(map(float, step)) for step in re.findall(r"^([\d.]+) mm (\S+) (\S+) (\S+) N$", said, re.MULTILINE)]
    assert len(steps) >= 20
    assert all(abs(x) < 0.1 for depth, x, y, z in steps if depth < 5.0)
    assert min(x for _, x, _, _ in steps) < -2.0  # it pushes out
    assert max(x for _, x, _, _ in steps) < 0.1
    assert {(y, z) for _, _, y, z in steps} == {(0.0, 0.0)}
    assert "log HapticMaster: established paper" in said
    assert "error" not in said
    assert said.splitlines()[-1] == "force 0 link none"


def test_a_master_feels_the_scene_of_a_slave_of_hapticnet(built):
    with running_slave() as port:
        said = check_felt(["mono", built / "SmallestMaster.exe", "127.0.0.1", port, 2], at_least=5, above_n=2.0)
    assert "\nEstablished paper" in said  # the hand may still print after it


def test_a_master_of_hapticnet_feels_the_spring_of_a_slave(built):
    with taken_port() as port:
        done = run(built, "SmallestSlave", port)
    assert done.returncode == 2
    assert done.stderr.startswith(f"127.0.0.1:{port} cannot be used: ")
    check_slave(["mono", built / "SmallestSlave.exe"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("SmallestMaster", "127.0.0.1", "x"), "usage: SmallestMaster.exe [HOST [PORT [SECONDS]]]"),
        (("SmallestMaster", "127.0.0.1", "99999"), "the port is 99999; it must be 1 to 65535"),
        (("SmallestMaster", "127.0.0.1", "47800", "x"), "usage: SmallestMaster.exe [HOST [PORT [SECONDS]]]"),
        (("SmallestSlave", "x"), "usage: SmallestSlave.exe [PORT]"),
        (("SmallestSlave", "99999"), "the port is 99999; it must be 0 to 65535"),
    ],
)
def test_an_example_refuses_wrong_arguments_in_one_line(built, arguments, said):
    program, *wrong = arguments
    assert check_refused(["mono", built / f"{program}.exe", *wrong], said) == f"{said}\n"


def test_a_link_allocates_nothing_while_it_ticks(built):
    """With a nursery of 64 kB, 16 bytes a tick would be seen."""
    with running_slave() as port:
        done = run(built, "Steady", port, 5000, MONO_GC_PARAMS="nursery-size=64k")
    said = re.search(r"master: (\d+) collections in (\d+) ticks", done.stdout)
    assert said, done.stdout + done.stderr
    assert int(said[1]) == 0
    assert int(said[2]) > 1000
    state, force_n = re.search(r"state (\w+) force (\S+)", done.stdout).groups()
    assert (state, float(force_n) > 1.0) == ("Established", True)
    assert "seen: True" in done.stdout
    collections, ticks = map(int, re.search(r"both: (\d+) collections in (\d+) ticks", done.stdout).groups())
    assert collections * 65536 / ticks < 600  # the README says 400 bytes for each datagram


def test_unity_moves_a_hand_and_is_pushed_in_the_frame_of_the_scene(built):
    with running_slave() as port:
        done = run(built, "Life", port, 2)
    assert (done.returncode, done.stderr) == (0, "")
    check_life(done.stdout)


def test_unity_has_sealed_sessions_with_key_files_of_hapticnet(built, tmp_path):
    with running_slave(*write_keys(tmp_path)) as port:
        done = run(built, "Life", port, 2, format_key(SLAVE.public), XDG_CONFIG_HOME=f"{tmp_path}/master")
        check_life(done.stdout)
        stranger = run(built, "Life", port, 1, format_key(SLAVE.public), tmp_path / "slave" / "key.toml")
        missing = run(built, "Life", port, 1, format_key(SLAVE.public), tmp_path / "nothing.toml")
    assert "error HapticMaster: the slave ended the session: " in stranger.stdout
    assert f"error HapticMaster: {tmp_path}/nothing.toml does not exist" in missing.stdout
    assert missing.stdout.splitlines()[-1] == "force 0 link none"


def test_what_is_wrong_is_one_sentence(built):
    done = run(built, "Wrong")
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        "rate_hz is 5; it must be between 20 and 100000",
        f"codec is 'deadbnad'; it must be one of {', '.join(codec_names())}",
        f"name is '{'x' * 65}'; it must be at most 64 bytes of printable UTF-8",
        "axes is 4; it must be 1 to 3",
        "axes is -1; it must be 1 to 3",
        "parameter is 'stepn'; it must be one of deadband's: step_n",
        "fine",
        "axes is 0; it must be 1 to 3",
        "a key is 44 characters of base64 that end in '=' (32 bytes); this has 3 characters",
        "the private key has 31 bytes; a key has 32",
        "/nonexistent/key.toml does not exist; 'hapticnet key new' makes a key",
        "/nonexistent/masters.toml does not exist; 'hapticnet key new' makes a key",
        "the slave's public key is none; 'hapticnet key public' prints it on the slave's host",
        "the position has 1 elements; it needs one for each axis: 2",
        "the buffer has 100 bytes; a datagram can have 1200",
        "the datagram is said to have 4 bytes, but the array has 3",
        "the address has 40 bytes; it can have 28",
        "'nowhere.invalid' is no host with an IPv4 address",
        "the port is 0; it must be 1 to 65535",
        "a hand is needed",
        "InvalidOperationException: no device",
        "InvalidOperationException: no scene",
        "Closed: the scene failed",
        "the port is 99999; it must be 0 to 65535",
        "a scene is needed",
        "the source of random numbers failed: no entropy",
    ]


def test_without_the_native_library_it_says_how_to_get_it(built, tmp_path):
    for name in ("SmallestMaster.exe", "Hapticnet.dll"):
        shutil.copy(built / name, tmp_path)
    done = run(tmp_path, "SmallestMaster")
    assert done.returncode == 2
    assert done.stderr.startswith("the library 'hapticnet' is not found; build it with 'make -C peers/c shared'")
    assert len(done.stderr.splitlines()) == 1


def test_each_asset_of_the_package_has_an_identity_of_its_own():
    """Unity ignores assets of an installed package without one."""
    assets = {path for path in PACKAGE.rglob("*") if path.suffix != ".meta"}
    metas = {path.with_suffix(""): path.read_text() for path in PACKAGE.rglob("*.meta")}
    assert set(metas) == assets
    identities = [re.search(r"^guid: ([0-9a-f]{32})$", text, re.MULTILINE)[1] for text in metas.values()]
    assert len(set(identities)) == len(identities)
    assemblies = [json.loads(path.read_text()) for path in PACKAGE.rglob("*.asmdef")]
    assert {each["name"]: each["references"] for each in assemblies} == {
        "Hapticnet": [],
        "Hapticnet.Unity": ["Hapticnet"],
    }
    assert not any("UnityEngine" in path.read_text() for path in (PACKAGE / "Runtime").glob("*.cs"))


test_an_example_is_short_and_its_length_is_in_the_readme = length_test(HERE, "*.cs", 50)


def test_the_code_of_the_readme_is_that_of_the_example():
    code = re.search(r"```csharp\n(internal.*?)```", README.read_text(), flags=re.DOTALL)[1]
    source = (HERE / "examples" / "SmallestMaster.cs").read_text()
    lines = [line.strip() for line in code.splitlines() if line.strip() and "..." not in line]
    assert [line for line in lines if line not in source] == []
