"""A slave, a gateway and the page in Chromium, each as it is used: processes, and an origin of its own for the page."""

import functools
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry, PrivateKey, format_key, new_key
from hapticnet.runtime.system import SystemEntropy
from hapticnet_gateway.cli import read_token

WITHIN_MS = 30_000
SECRET = PrivateKey(bytes(range(32)))
SERVE_BUILT = """
import sys
from pathlib import Path
from hapticnet_gateway import gateway
dist = Path(sys.argv.pop(1))
page = [*dist.glob("page/*"), *dist.glob("*.js")]
kinds = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
files = {each.name: (each.read_bytes(), kinds[each.suffix]) for each in page}
gateway.static_files = lambda _: files
from hapticnet.cli import main
main()
"""
"""Run the command with the page of this build, wherever the checkout's own stands."""


class Process:
    """A process of hapticnet; `lines` has what it said."""

    def __init__(self, *arguments: object, folder: Path | None = None) -> None:
        command = (
            [sys.executable, "-m", "hapticnet"] if folder is None else [sys.executable, "-c", SERVE_BUILT, str(folder)]
        )
        self.process = subprocess.Popen(
            [*command, *map(str, arguments)], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with self._said:
                self.lines.append(line)
                self._said.notify_all()

    def said(self, pattern: str, times: int = 1) -> list[re.Match[str]]:
        """Wait until it has said something, and return what matches."""

        def found() -> list[re.Match[str]]:
            return [match for line in self.lines if (match := re.search(pattern, line))]

        with self._said:
            assert self._said.wait_for(lambda: len(found()) >= times, WITHIN_MS / 1000), (
                f"{pattern!r} not in {self.lines}"
            )
            return found()

    def stop(self, number: int = signal.SIGTERM) -> None:
        self.process.send_signal(number)
        self.process.wait(WITHIN_MS / 1000)
        self._reader.join()
        assert self.process.stderr is not None
        self.process.stderr.close()


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder at an origin of its own; yield that."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


def free_port() -> int:
    """Return a port that nothing listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Rig:
    """A slave, a gateway, and what a tab needs to touch the slave's scene through it."""

    def __init__(self, folder: Path, built: Path, origin: str) -> None:
        own, slave = new_key(SystemEntropy()), new_key(SystemEntropy())
        write_key(folder / "slave.toml", slave)
        (folder / "masters.toml").write_text(dump_master(MasterEntry(name="tab", public=own.public)))
        keys = ["--key", folder / "slave.toml", "--masters", folder / "masters.toml"]
        write_key(folder / "token.toml", SECRET)
        self.slave = Process("slave", "--listen", "127.0.0.1:0", "--scene", "paper:1", *keys)
        (found,) = self.slave.said(r"listening on (\S+),")
        self.url = f"http://127.0.0.1:{free_port()}"
        here = self.url.removeprefix("http://")
        self._command = ["gateway", "--slave", found[1], "--listen", here, "--token", folder / "token.toml"]
        self._command += ["--origin", origin]
        self._built = built
        self.start_gateway()
        self.fragment = {
            "token": read_token(folder / "token.toml"), "begin": "1",
            "key": format_key(own.private), "slave": format_key(slave.public),
        }  # fmt: skip

    def start_gateway(self) -> None:
        self.gateway = Process(*self._command, folder=self._built)
        self.gateway.said("page:")

    def address(self, page: str | None = None, **more: str) -> str:
        """Return the page's address, with everything in its fragment, so that it begins by itself."""
        return f"{page or self.url}/#{urlencode(self.fragment | more)}"

    def close(self) -> None:
        for each in (self.gateway, self.slave):
            if each.process.poll() is None:
                each.stop()


def press(page: Any, depth_mm: float) -> None:
    """Drag the tool down by some depth."""
    box = page.locator("#scene").bounding_box()
    x, y = box["x"] + 100, box["y"] + 20
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y + depth_mm / 85 * (box["height"] - 32), steps=5)


def until(page: Any, expression: str) -> None:
    """Wait until an expression is true; playwright's own way needs what the page's policy forbids."""
    end_s = time.monotonic() + WITHIN_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end_s, expression
        page.wait_for_timeout(30)


def renderers() -> list[int]:
    """Return the processes of Chromium, started by this one, in which pages run."""
    found = []

    def walk(pid: int) -> None:
        for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
            for child in map(int, tasks.read_text().split()):
                if b"--type=renderer" in Path(f"/proc/{child}/cmdline").read_bytes():
                    found.append(child)
                walk(child)

    walk(os.getpid())
    return found
