"""hapticnet processes as children of another process: start, read messages, end by process id."""

import ctypes
import os
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from hapticnet.errors import UnavailableError
from hapticnet.runtime.interpreter import python_command

LISTENING: Final = "listening on "
"""Start of a slave's message that it can be reached, followed by its address and a comma."""

END_WITHIN_S: Final = 5.0

KEY_VARIABLES: Final = ("HAPTICNET_KEY", "HAPTICNET_PEER_KEY", "HAPTICNET_MASTERS")
"""Environment variables that name keys. They are for sessions with other hosts; children serve this one."""

OPTION_VARIABLES: Final = ("HAPTICNET_CONFIG", "HAPTICNET_MASTER_", "HAPTICNET_SLAVE_", "HAPTICNET_CHANNEL_")
"""Starts of environment variables that set options of what the user starts; children get theirs as arguments."""

PR_SET_PDEATHSIG: Final = 1
"""Option of prctl(2) on Linux: receive a signal when the parent dies, for whatever reason."""


class Child:
    """A ``hapticnet`` process with its stderr on a pipe. It ends when this process ends, even if that is killed.

    Parameters
    ----------
    arguments
        Command line after ``hapticnet``.
    environment
        Its environment variables; None for those of this process without `KEY_VARIABLES` and `OPTION_VARIABLES`.
    """

    def __init__(self, arguments: Sequence[str], *, environment: Mapping[str, str] | None = None) -> None:
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
            env=_own_variables(os.environ) if environment is None else environment,
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
        raise UnavailableError(f"'{self._command}' ended before it listened: {'; '.join(said)}")

    def lines(self) -> Iterator[str]:
        """Yield the lines that the process says, as they come, until it ends."""
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


def _own_variables(environment: Mapping[str, str]) -> dict[str, str]:
    hidden = (*KEY_VARIABLES, *OPTION_VARIABLES)
    return {name: value for name, value in environment.items() if not name.startswith(hidden)}
