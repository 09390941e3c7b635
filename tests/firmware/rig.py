"""A test rig: a finger pressed by the compiled firmware, and a record of the forces on it."""

from collections.abc import Callable
from pathlib import Path

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.node.fingertip import Fingertip, FingertipEvent
from hapticnet.runtime.nano import Simavr, SimulatedNano

MS = 1_000
FINGERS_N_M = (300.0, 1000.0, 3000.0)
FOUND_AND_PRESSED_MS = 1_800
HANG = 0xDEAD

RETRACT_MS = 150
"""Longest time for a servo to leave the finger: at most 60° in 170 ms, HS-55 data sheet."""


class Rig:
    """A fingertip on a simulated Nano, with a record of the force on the finger every millisecond."""

    def __init__(self, nano: SimulatedNano, build: tuple[Path, Path]) -> None:
        self.nano = nano
        self.build = build
        self.fingertip = Fingertip(nano, ForceControlSettings())
        self.now_us = 0
        self.felt_n: list[float] = []
        self.events: list[tuple[int, FingertipEvent]] = []

    def press(self, force_n: float, milliseconds: int) -> list[float]:
        """Set a target force; return the forces on the finger meanwhile."""
        return self.play(lambda _: force_n, milliseconds)

    def play(self, force_n: Callable[[int], float], milliseconds: int) -> list[float]:
        """Set a target force as a function of time [µs]; return the forces on the finger meanwhile."""
        for _ in range(milliseconds):
            self.now_us += MS
            self.fingertip.press(force_n(self.now_us), self.now_us)
            self.felt_n.append(self.nano.contact_force_n)
            while event := self.fingertip.next_event():
                self.events.append((self.now_us // MS, event))
        return self.felt_n[-milliseconds:]

    def stall(self, milliseconds: int) -> list[float]:
        """Stall the host while everything else continues; afterwards it receives everything at once."""
        heard = b""
        for _ in range(milliseconds):
            self.now_us += MS
            heard += self.nano.board.advance(self.now_us)
            self.felt_n.append(self.nano.contact_force_n)
        self.nano._now_us = self.now_us
        self.nano.wired.receive(heard, self.now_us)
        return self.felt_n[-milliseconds:]

    def restart(self, force_n: float, dark_ms: int) -> list[float]:
        """Reset the controller during a target force; it is inactive, as in its bootloader, and restarts."""
        board = self.nano.board
        board._simavr.close()

        def dark(now_us: int, _data: bytes = b"") -> bytes:
            board.plant.advance(now_us)
            return b""

        board.advance = dark
        felt_n = self.press(force_n, dark_ms)
        del board.advance
        board._simavr = Simavr(*self.build)
        board._cycle = 0
        board.set_clock(self.now_us)
        return felt_n

    def also_send(self, message: Callable[[], bytes]) -> None:
        """Add bytes to the host's output."""
        wired, usual = self.nano.wired, self.nano.wired.bytes_to_send
        wired.bytes_to_send = lambda: usual() + message()

    def times_ms(self, kind: type[FingertipEvent]) -> list[int]:
        return [at_ms for at_ms, event in self.events if isinstance(event, kind)]


def released_ms(felt_n: list[float]) -> int:
    """Return the number of milliseconds until the force on the finger is 0."""
    assert 0.0 in felt_n, f"still {felt_n[-1]:.2f} N after {len(felt_n)} ms"
    return felt_n.index(0.0) + 1
