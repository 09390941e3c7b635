"""Programs of peers beside those of hapticnet, over UDP and in real time: what the tests of several peers need."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from conformance.session import ENTRY, MASTER, SLAVE
from hapticnet.protocol.key_files import dump_master, write_key

_HAPTICNET: Final = (sys.executable, "-m", "hapticnet")


def need(*tools: str) -> None:
    """Skip a test whose tools are missing; fail it in CI."""
    missing = ", ".join(tool for tool in tools if shutil.which(tool) is None)
    if missing and os.environ.get("CI"):
        pytest.fail(f"{missing} missing; CI must have it")
    if missing:
        pytest.skip(f"{missing} missing")


@contextmanager
def taken_port() -> Iterator[int]:
    """Yield a UDP port of this machine that is in use until the end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


def free_port() -> int:
    """Return a UDP port of this machine that was free a moment ago."""
    with taken_port() as port:
        return port


@contextmanager
def running_slave(*options: object) -> Iterator[int]:
    """Run a slave of hapticnet with the scene paper; yield its port."""
    command = [*_HAPTICNET, "slave", "--scene", "paper", "--listen", "127.0.0.1:0", *map(str, options)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        try:
            ports = (re.search(r"listening on 127\.0\.0\.1:(\d+)", line) for line in process.stderr or ())
            yield int(next(port[1] for port in ports if port))
        finally:
            process.terminate()


def write_keys(folder: Path) -> tuple[object, ...]:
    """Write key files for a sealed session; return the slave's options.

    The master's is `folder/master/hapticnet/key.toml`, so that `XDG_CONFIG_HOME=folder/master` finds it. It is that of
    `session.MASTER`; the slave's is that of `session.SLAVE`.
    """
    own, masters = folder / "slave" / "key.toml", folder / "slave" / "masters.toml"
    write_key(folder / "master" / "hapticnet" / "key.toml", MASTER)
    write_key(own, SLAVE)
    masters.write_text(dump_master(ENTRY))
    return "--key", own, "--masters", masters


def check_felt(command: Sequence[object], *, at_least: int = 20, above_n: float = 3.0) -> str:
    """Check that a master feels nothing before the tissue of the scene paper, and then its skin.

    Parameters
    ----------
    command : sequence
        A program that prints depths and forces in lines like `12.0 mm 1.5 N`, and ends by itself.
    at_least : int
        Least number of such lines.
    above_n : float
        What the largest force exceeds [N].

    Returns
    -------
    str
        What the program printed.
    """
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    felt = [(float(x), float(n)) for x, n in re.findall(r"([\d.]+) mm +([\d.-]+) N", done.stdout)]
    assert len(felt) >= at_least, done.stdout
    assert all(abs(n) < 0.1 for x, n in felt if x < 10.0), done.stdout
    assert max(n for _, n in felt) > above_n, done.stdout
    return done.stdout


def check_slave(command: Sequence[object], scene: str = "spring") -> None:
    """Check that a master of hapticnet has one session with a slave, in which every datagram is well formed.

    Parameters
    ----------
    command : sequence
        The slave's program, which takes a port as its last argument.
    scene : str
        The name of its scene.
    """
    port = str(free_port())
    with subprocess.Popen([*map(str, command), port], stdout=subprocess.DEVNULL) as slave:
        master = [*_HAPTICNET, "master", "--connect", f"127.0.0.1:{port}", "--json", "--duration", "3"]
        done = subprocess.run(master, capture_output=True, text=True, timeout=60, check=False)
        slave.terminate()
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["scene"], report["connections"], report["received"]["malformed"]) == (scene, 1, 0)


def check_refused(command: Sequence[object], said: str) -> str:
    """Check that a program refuses its arguments: in one line, which begins so and is returned, and with code 2."""
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert done.stderr.startswith(said), done.stderr
    return done.stderr


def codec_names() -> list[str]:
    """Return the names of all codecs, in the order of the C library."""
    header = Path(__file__).parents[1] / "c" / "include" / "hapticnet_constants.h"
    return re.findall(r'CODEC\(HN_CODEC_\w+, "([\w-]+)"', header.read_text())


def length_test(folder: Path, pattern: str, most: int) -> Callable[[Path], None]:
    """Return a test that each example of a peer is short, and that the README of the peer says its length.

    Parameters
    ----------
    folder : Path
        The peer's.
    pattern : str
        What its examples are called, such as `*.c`.
    most : int
        Most lines.
    """

    @pytest.mark.parametrize("example", sorted((folder / "examples").glob(pattern)), ids=lambda path: path.stem)
    def test(example: Path) -> None:
        lines = len(example.read_text().splitlines())
        assert lines <= most
        said = f"[examples/{example.name}](examples/{example.name}) ({lines} lines)"
        assert said in (folder / "README.md").read_text()

    return test
