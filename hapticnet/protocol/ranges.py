"""The range of each number in a message. docs/refer/protocol.md has the same table.

A request whose numbers are out of range is refused, in words. Any other message with such a number is malformed: it is
counted, and changes nothing.
"""

from typing import Final, NamedTuple

from hapticnet.checks import check_parameter


class Range(NamedTuple):
    """A closed range of numbers, and 0 where `zero_allowed`."""

    name: str
    smallest: float
    largest: float
    unit: str = ""
    zero_allowed: bool = False

    def has(self, value: float) -> bool:
        """Return whether a number is in the range; NaN is not."""
        return self.smallest <= value <= self.largest or (self.zero_allowed and value == 0)

    def check(self, value: float) -> None:
        """Raise SettingsError if a number is not in the range."""
        check_parameter(self.name, value, self.smallest, self.largest, self.unit, zero_allowed=self.zero_allowed)


RATE_HZ: Final = Range("rate", 20.0, 100_000.0, "Hz")
"""Positions per second. A slave sends only when it receives: at 20 Hz, four times per age limit of 200 ms."""

POSITION_SHARE: Final = Range("share of positions", 0.01, 0.9, zero_allowed=True)
"""Share of the JND that positions may use; 0: every position is sent."""

KEEPALIVE_US: Final = Range("keepalive interval", 1_000, 50_000, "µs")
"""Longest silence without loss: at most a quarter of the age limit of 200 ms."""

CLOCK_US: Final = Range("clock", 0, (1 << 53) - 1, "µs")
"""The master's clock: 285 years, which recordings hold as float64 without rounding."""

HELLO_SEQUENCE: Final = Range("sequence of a sealed HELLO", 0, (1 << 20) - 1)
"""The first epoch of keys (`protocol.seal`): a session that began later could not open its datagrams."""

PERCENT: Final = Range("loss", 0, 100, "%")
"""Shares in the report of loss."""
