"""A process beside a node's: it does what would delay ticks. It is fed through a pipe that nobody waits for."""

import asyncio
import fcntl
import os
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final

from hapticnet.runtime.frames import pack_frame
from hapticnet.runtime.interpreter import python_command

PIPE_BYTES: Final = 2**20
"""Capacity [B] of the pipe: what the process may be behind. Linux permits this much without privileges."""

END_WITHIN_S: Final = 1.0
POLL_S: Final = 0.01


class SideProcess:
    """A child process at normal priority that reads frames on its standard input and ends when the pipe is closed.

    It ends when this process ends, even if that is killed. A Ctrl-C on the terminal does not reach it.

    Parameters
    ----------
    module
        The module that is run.
    descriptors
        File descriptors that the process gets; their numbers are its first arguments.
    arguments
        Further arguments.
    name
        What messages call the process.
    tell
        Called with a line for the user if the process ends early.

    Attributes
    ----------
    left_out
        Frames that were not sent, because the process was too far behind or had ended.
    process_id
        Its number.
    """

    def __init__(
        self,
        module: str,
        descriptors: Sequence[int],
        arguments: Sequence[str] = (),
        *,
        name: str,
        tell: Callable[[str], None],
    ) -> None:
        self.left_out = 0
        self._name = name
        self._tell = tell
        self._rest = b""
        self._process = subprocess.Popen(  # noqa: S603 - our own module, arguments not through a shell
            python_command("-m", module, *map(str, descriptors), *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=descriptors,
            start_new_session=True,
            preexec_fn=_normal_priority,
        )
        self.process_id = self._process.pid
        assert self._process.stdin is not None  # noqa: S101 - for the type checker: stdin is a pipe
        self._pipe: int | None = os.dup(self._process.stdin.fileno())
        self._process.stdin.close()
        os.set_blocking(self._pipe, False)
        with suppress(OSError):  # the user's limit of pipes is reached; the default is 64 KiB
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    def send(self, kind: int, body: bytes) -> bool:
        """Send a frame without waiting; return False if it is left out, because the process is too far behind."""
        sent = False
        try:
            if self._pipe is not None and self._rest:  # a frame that did not fit completely
                self._rest = self._rest[os.write(self._pipe, self._rest) :]
            if self._pipe is not None and not self._rest:
                frame = pack_frame(kind, body)
                self._rest = frame[os.write(self._pipe, frame) :]
                sent = True
        except BlockingIOError:
            pass
        except OSError:
            self._has_ended()
        self.left_out += not sent
        return sent

    async def stop(self) -> None:
        """Let the process end, and kill it if that takes long."""
        if self._pipe is not None and self._process.poll() is not None:
            self._has_ended()
        self._close()
        waited_s = 0.0
        while self._process.poll() is None and waited_s < END_WITHIN_S:
            await asyncio.sleep(POLL_S)
            waited_s += POLL_S
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _has_ended(self) -> None:
        self._close()
        with suppress(subprocess.TimeoutExpired):  # its end of the pipe is closed a moment before it ends
            self._process.wait(POLL_S)
        self._tell(f"{self._name} has ended unexpectedly (exit code {self._process.poll()}); the run goes on")

    def _close(self) -> None:
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None


def _normal_priority() -> None:
    with suppress(AttributeError, OSError):  # not on Linux
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
