"""One process of a worker, as its parent sees it."""

import asyncio
import ctypes
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from hapticnet.runtime.children import PR_SET_PDEATHSIG
from hapticnet.runtime.workers.link import Say, hear, say_to

POLL_S: Final = 0.02

MOST_LINE_BYTES: Final = 1 << 20


class WorkerProcess:
    """One process of a worker, from start to end.

    Parameters
    ----------
    module
        The module that is run. Its first argument is the descriptor of the line to the parent.
    descriptors
        Further descriptors that it gets; their numbers are its other arguments.
    on_line
        Called with each line that it writes.

    Attributes
    ----------
    ready, news, report, failure
        What it has said; None if it has not.
    heard_s
        When it said something last [s], on the loop's clock.
    """

    def __init__(self, module: str, descriptors: Sequence[int], on_line: Callable[[str], None]) -> None:
        self.ready: dict[str, Any] | None = None
        self.news: dict[str, Any] | None = None
        self.report: dict[str, Any] | None = None
        self.failure: dict[str, Any] | None = None
        self.heard_s = 0.0
        self._module = module
        self._descriptors = descriptors
        self._on_line = on_line
        self._writer: asyncio.StreamWriter | None = None
        self._process: subprocess.Popen[bytes] | None = None

    async def run(self, set_up: Mapping[str, Any], on_change: Callable[[], None]) -> int:
        """Start the process and follow it to its end; return its exit code, negative for a signal.

        `on_change` is called when it is ready or has ended.
        """
        loop = asyncio.get_running_loop()
        here, there = socket.socketpair()
        process = self._start(there)
        there.close()
        lines = asyncio.ensure_future(self._read_lines(process))
        reader, self._writer = await asyncio.open_connection(sock=here)
        say_to(self._writer, Say.SET_UP, set_up)
        while (frame := await hear(reader)) is not None:
            self.heard_s = loop.time()
            match frame:
                case Say.READY, content:
                    self.ready = content
                    on_change()
                case Say.NEWS, content:
                    self.news = content
                case Say.REPORT, content:
                    self.report = content
                case Say.FAILED, content:
                    self.failure = content
        self._writer.close()
        while (code := process.poll()) is None:
            await asyncio.sleep(POLL_S)
        await lines
        on_change()
        return code

    def say(self, kind: Say) -> None:
        """Tell the process something, if it runs."""
        if self._writer is not None:
            say_to(self._writer, kind)

    def kill(self) -> None:
        """End the process at once."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()

    def _start(self, line: socket.socket) -> "subprocess.Popen[bytes]":
        prctl, parent = ctypes.CDLL(None).prctl, os.getpid()

        def end_with_parent() -> None:
            prctl(PR_SET_PDEATHSIG, signal.SIGTERM)  # for a process that does not listen to the line yet
            if os.getppid() != parent:
                os._exit(1)

        descriptors = [line.fileno(), *self._descriptors]
        environment = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
        self._process = subprocess.Popen(  # noqa: S603 - our own module, arguments not through a shell
            [sys.executable, "-m", self._module, *map(str, descriptors)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=descriptors,
            start_new_session=True,  # a Ctrl-C on the terminal is for the parent
            preexec_fn=end_with_parent,
            env=environment,
        )
        return self._process

    async def _read_lines(self, process: "subprocess.Popen[bytes]") -> None:
        loop = asyncio.get_running_loop()
        reader = asyncio.StreamReader(MOST_LINE_BYTES)
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), process.stdout)
        while True:
            with suppress(ValueError):  # a line without end
                line = await reader.readline()
                if not line:
                    return
                if text := line.decode("utf-8", "replace").strip():
                    self._on_line(text)
