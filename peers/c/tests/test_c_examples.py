"""The examples, over UDP and in real time."""

import json
import re
import socket
import subprocess
import sys

import pytest

import peer

LINES = 60


@pytest.fixture
def slave():
    """A slave of hapticnet with the paper's scene; its port."""
    command = [sys.executable, "-m", "hapticnet", "slave", "--scene", "paper", "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        ports = (re.search(r"listening on 127\.0\.0\.1:(\d+)", line) for line in process.stderr)
        yield next(port[1] for port in ports if port)
        process.terminate()


def test_the_example_of_a_master_feels_the_scene_of_a_slave_of_hapticnet(build_folder, slave):
    program = peer.build("examples", build_folder) / "master"
    done = subprocess.run([program, "127.0.0.1", slave, "2"], capture_output=True, text=True, check=True, timeout=30)
    felt = [(float(x), float(n)) for x, n in re.findall(r"([\d.]+) mm +([\d.-]+) N", done.stdout)]
    assert len(felt) >= 20
    assert all(abs(n) < 0.1 for x, n in felt if x < 10.0)
    assert max(n for _, n in felt) > 3.0


def test_a_master_of_hapticnet_feels_the_spring_of_the_example_of_a_slave(build_folder):
    program = peer.build("examples", build_folder) / "slave"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with subprocess.Popen([program, str(port)]) as slave:
        command = [sys.executable, "-m", "hapticnet", "master", "--connect", f"127.0.0.1:{port}", "--json"]
        done = subprocess.run([*command, "--duration", "3"], capture_output=True, text=True, timeout=30)
        slave.terminate()
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["scene"], report["connections"], report["received"]["malformed"]) == ("spring", 1, 0)


@pytest.mark.parametrize("example", sorted((peer.HERE / "examples").glob("*.c")), ids=lambda path: path.stem)
def test_an_example_is_short_and_its_length_is_in_the_readme(example):
    lines = len(example.read_text().splitlines())
    assert lines <= LINES
    assert (
        f"[examples/{example.name}](examples/{example.name}) ({lines} lines)" in (peer.HERE / "README.md").read_text()
    )
