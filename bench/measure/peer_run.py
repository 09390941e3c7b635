"""Run both ends of a stack over a link, and measure what they send and what CPU time they take."""

import json
import os
import select
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from peer_ends import PAPER
from peer_link import FAR_HOST, Link, cpu_us, sent
from stacks import PORT

ENDS: Final = Path(__file__).with_name("peer_ends.py")
REPOSITORY: Final = Path(__file__).parents[2]
START_WITHIN_S: Final = 30.0
"""Longest time for a process to start, and to connect over a link with loss."""


class StackError(Exception):
    """A stack that did not work, in words."""


class Runner:
    """Measure one stack after the other.

    Parameters
    ----------
    folder
        Where the near end writes what it saw.
    keys
        Options of a slave with sealed sessions.
    ticks
        Ticks of each measurement.
    fifo
        Whether everything has a real-time priority, the threads and brokers of the stacks included.
    scene
        What the far end hosts, as for ``hapticnet slave --scene``.
    motion
        Values of `InsertionSettings` for the hand; None for its defaults.
    """

    def __init__(
        self,
        folder: Path,
        keys: list[str],
        *,
        ticks: int,
        seed: int,
        fifo: bool,
        scene: str = PAPER,
        motion: dict[str, float] | None = None,
    ) -> None:
        self.scene = scene
        self._folder, self._keys, self._ticks, self._seed, self._fifo = folder, keys, ticks, seed, fifo
        self._motion = json.dumps(motion or {})
        self._environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}

    def run(self, wire: Link, name: str, settings: dict[str, Any] | None) -> dict[str, Any]:
        """Run a stack by its name, or hapticnet with settings; return the figures, and the ticks ``seen``.

        Raises
        ------
        StackError
            If an end does not start, does not connect or ends too early.
        """
        with ExitStack() as ends:
            near = self._start(ends, wire, "near", self._near(name, settings))
            far = self._start(ends, wire, "far", self._far(name, settings))
            if settings is None:
                helpers = [int(word) for word in far.line("ready").split()[1:]]
            else:
                far.line("listening on", START_WITHIN_S)
                helpers = []
            near.go_on()
            near.line("begin")
            before = self._counters(wire, near, far, helpers)
            near.line("end", self._ticks / 1e3 * 3.0)
            after = self._counters(wire, near, far, helpers)
            near.go_on()
            near.finish()
        seen = json.loads((self._folder / "seen.json").read_text())
        packets, size, near_us, far_us = ((b - a) / self._ticks for a, b in zip(before, after, strict=True))
        return {
            "packets": packets,
            "bytes": size,
            "cpu_near_us": near_us,
            "cpu_far_us": far_us,
            "cpu_us": near_us + far_us,
            "p50_us": seen["trips_us"]["p50"],
            "p99_us": seen["trips_us"]["p99"],
            "answers": seen["arrived"] / self._ticks,
            "load": os.getloadavg()[0],
            "seen": seen,
        }

    def _far(self, name: str, settings: dict[str, Any] | None) -> list[str]:
        if settings is None:
            command = [str(ENDS), "far", name, FAR_HOST, "--scene", self.scene]
            return command + (["--real-time"] if self._fifo else [])
        command = ["-m", "hapticnet", "slave", "--listen", f"{FAR_HOST}:{PORT}", "--scene", self.scene]
        command += ["--real-time" if self._fifo else "--no-real-time"]
        command += self._keys if settings["sealed"] else ["--insecure"]
        return command

    def _near(self, name: str, settings: dict[str, Any] | None) -> list[str]:
        command = [str(ENDS), "near", name if settings is None else "hapticnet", FAR_HOST]
        command += ["--ticks", str(self._ticks), "--seed", str(self._seed), "--out", str(self._folder / "seen.json")]
        command += ["--motion", self._motion]
        if settings is not None:
            command += ["--settings", json.dumps(settings)]
        return command + (["--real-time"] if self._fifo else [])

    def _start(self, ends: ExitStack, wire: Link, end: str, arguments: list[str]) -> "End":
        started = End(wire.command(end, [sys.executable, *arguments]), self._folder / f"{end}.txt", self._environment)
        ends.callback(started.end)
        return started

    def _counters(self, wire: Link, near: "End", far: "End", helpers: list[int]) -> tuple[float, ...]:
        """Return packets and bytes that both ends have sent, and the CPU time [µs] of the near and the far one."""
        both = [sent(end.process_id, wire.extra_bytes) for end in (near, far)]
        cpu = cpu_us([near.process_id]), cpu_us([far.process_id, *helpers])
        return *(float(sum(column)) for column in zip(*both, strict=True)), *cpu


class End:
    """A process of a measurement; its stderr goes to a file, from which a slave's messages are read."""

    def __init__(self, command: list[str], said: Path, environment: dict[str, str]) -> None:
        self._said = said
        with said.open("wb") as file:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=file, env=environment, bufsize=0
            )
        self.process_id = self._process.pid  # `ip netns exec` becomes the command

    def line(self, start: str, within_s: float = START_WITHIN_S) -> str:
        """Wait for a line of the process that contains these words, and return it."""
        assert self._process.stdout is not None
        until_s = time.monotonic() + within_s
        while time.monotonic() < until_s:
            if select.select([self._process.stdout], [], [], 0.02)[0]:
                line = self._process.stdout.readline().decode()
                if start in line:
                    return line
                if not line:
                    raise StackError(f"a process ended before {start!r}: {self._last()}")
            elif start in (said := self._said.read_text(errors="replace")):
                return said
        raise StackError(f"no {start!r} within {within_s:.0f} s: {self._last()}")

    def go_on(self) -> None:
        """Let the near end connect, or finish."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")

    def finish(self) -> None:
        """Wait for the process to end by itself."""
        try:
            code = self._process.wait(START_WITHIN_S)
        except subprocess.TimeoutExpired:
            raise StackError("the near end did not finish") from None
        if code:
            raise StackError(f"the near end failed: {self._last()}")

    def end(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(3.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()

    def _last(self) -> str:
        lines = self._said.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"
