"""Helper processes, which end with this one: start, feed, read and end them."""

import ctypes
import fcntl
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from hapticnet.errors import UnavailableError

SAFE_PATH: Final = "PYTHONSAFEPATH"  # has the effect of -P: Python does not search the working folder for modules


def python_command(*arguments: str) -> list[str]:
    """Return the command line of a Python process, which imports no modules from the working folder (-P)."""
    return [sys.executable, "-P", *arguments]


@contextmanager
def safe_path() -> Iterator[None]:
    """Do the same for processes of multiprocessing in this context: their command lines are not ours."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


PIPE_BYTES: Final = 2**20  # Capacity [B] of the pipe to a side process. Linux permits this much without privileges.
MOST_AT_ONCE: Final = 256 * 1024  # most bytes that are written in one call: less than 0.1 ms
POLL_S: Final = 0.01


class SideProcess:
    """A child process at normal priority, a module fed through its standard input; it ends when that is closed.

    It never blocks its parent, and a Ctrl-C does not reach it. Raises UnavailableError if it cannot be started.
    """

    def __init__(self, module: str, *arguments: str, descriptors: Sequence[int] = ()) -> None:
        self.waiting_bytes = 0  # bytes that the pipe has not accepted yet
        self._waiting: deque[memoryview] = deque()
        self._partial = b""
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own module, arguments not through a shell
                python_command("-m", module, *arguments),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
                pass_fds=descriptors,
                start_new_session=True,
                preexec_fn=_normal_priority,
            )
        except OSError as error:
            raise UnavailableError(f"cannot start {module}: {error.strerror}") from error
        assert self._process.stdin is not None  # noqa: S101 - for the type checker: both are pipes
        assert self._process.stdout is not None  # noqa: S101
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        self.pid = self._process.pid  # its number
        for pipe in (self._stdin, self._stdout):
            os.set_blocking(pipe.fileno(), False)
        with suppress(AttributeError, OSError):  # not on Linux, or the user's limit of pipes is reached
            fcntl.fcntl(self._stdin.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    @property
    def exit_code(self) -> int | None:
        """How it ended, as from subprocess; None while it runs."""
        return self._process.poll()

    def put(self, data: bytes | memoryview) -> None:
        """Queue bytes, which must not change any more; `pump` passes them on."""
        view = memoryview(data)
        self._waiting.append(view)
        self.waiting_bytes += view.nbytes

    def pump(self) -> None:
        """Pass on as much as the pipe accepts now, without waiting. If the process has ended, drop the queue."""
        written = 0
        try:
            while self._waiting and written < MOST_AT_ONCE:
                piece = self._waiting[0]
                count = os.write(self._stdin.fileno(), piece[:MOST_AT_ONCE])
                written += count
                self.waiting_bytes -= count
                if count == len(piece):
                    self._waiting.popleft()
                else:
                    self._waiting[0] = piece[count:]
        except BlockingIOError:
            pass
        except (OSError, ValueError):  # it has ended, or its input is closed
            self.drop()

    def drop(self) -> None:
        """Drop the queue."""
        self._waiting.clear()
        self.waiting_bytes = 0

    def said(self) -> list[bytes]:
        """Return the lines that it wrote since the last call."""
        try:
            data = os.read(self._stdout.fileno(), 65536)
        except (BlockingIOError, ValueError):  # nothing new, or closed
            return []
        *lines, self._partial = (self._partial + data).split(b"\n")
        return lines

    def finish(self, within_s: float) -> bool:
        """Pass on the queue, close the input and wait up to `within_s` [s] for the end; return whether it came."""
        end_s = time.monotonic() + within_s
        while self.exit_code is None:
            self.pump()
            if not self._waiting:
                with suppress(OSError):
                    self._stdin.close()
            if time.monotonic() >= end_s:
                return False
            time.sleep(POLL_S)
        return True

    def close(self) -> None:
        """Close the pipes; kill the process if it runs."""
        if self.exit_code is None:
            self._process.kill()
            self._process.wait()
        for pipe in (self._stdin, self._stdout):
            with suppress(OSError):
                pipe.close()


def _normal_priority() -> None:
    with suppress(AttributeError, OSError):  # not on Linux
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


LISTENING: Final = "listening on "  # start of a slave's message that it can be reached, before its address and a comma
END_WITHIN_S: Final = 5.0
# Environment variables for the user's own commands: children serve this host, and get options as arguments.
HIDDEN: Final = ("HAPTICNET_KEY", "HAPTICNET_PEER_KEY", "HAPTICNET_MASTERS", "HAPTICNET_CONFIG")
PR_SET_PDEATHSIG: Final = 1  # option of prctl(2) on Linux: receive a signal when the parent dies, for whatever reason


class Child:
    """A ``hapticnet`` process with its stderr on a pipe. It ends when this process ends, even if that is killed."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self._arguments = arguments
        self._last = "nothing"
        prctl, parent = ctypes.CDLL(None).prctl, os.getpid()

        def end_with_parent() -> None:
            prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
            if os.getppid() != parent:  # the parent ended before prctl
                os._exit(1)

        self._process = subprocess.Popen(  # noqa: S603 - our own program, arguments not through a shell
            python_command("-m", "hapticnet", *arguments),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            preexec_fn=end_with_parent,
            env={name: value for name, value in os.environ.items() if name not in HIDDEN},
            text=True,
            encoding="utf-8",
        )

    def address(self) -> str:
        """Wait for the address on which the process listens, and return it; UnavailableError repeats its messages."""
        assert self._process.stderr is not None  # noqa: S101 - for the type checker: stderr is a pipe
        said = []
        for line in self._process.stderr:
            if LISTENING in line:
                return line.split(LISTENING, 1)[1].split(",", 1)[0].strip()
            said.append(line.strip())
        raise UnavailableError(f"'{self._command}' ended before it listened; it said: {'; '.join(said) or 'nothing'}")

    def lines(self) -> Iterator[str]:
        """Yield the lines of the process as they come, until it ends."""
        assert self._process.stderr is not None  # noqa: S101 - for the type checker: stderr is a pipe
        for line in self._process.stderr:
            self._last = line.strip()
            yield self._last

    def poll(self) -> bool:
        """Return whether the process has ended."""
        return self._process.poll() is not None

    def finish(self) -> None:
        """Wait for the process to end by itself; if it fails, UnavailableError repeats its last message."""
        _, said = self._process.communicate()
        if self._process.returncode:
            last = (said.strip().splitlines() or [self._last])[-1]
            last = last.rpartition(" error hapticnet: ")[2]  # without time and level
            raise UnavailableError(f"'{self._command}' failed ({self._process.returncode}); it said: {last}")

    def kill(self) -> None:
        """End the process at once. Can be called from another thread; a call that waits for the process returns."""
        self._process.kill()

    def end(self) -> None:
        """Terminate the process, and kill it after `END_WITHIN_S`."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.communicate(timeout=END_WITHIN_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.communicate()
        if self._process.stderr is not None:
            self._process.stderr.close()

    @property
    def _command(self) -> str:
        return f"hapticnet {self._arguments[0]}"
