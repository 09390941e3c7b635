"""When so little is applied in a session with few positions that a long silence does no harm.

Both sides decide it by themselves. The slave's limit is far below the master's, so that a master whose last update was
lost does not wait for keepalives that come more rarely.
"""

from typing import Final

from hapticnet.perception import PAPER_FLOOR_N, WeberLaw

LARGEST_N: Final = PAPER_FLOOR_N
"""Largest threshold [N] that is used here: 0.025 N, the smallest force difference that the paper's subjects could tell.
A large JND would otherwise let a force that presses a finger stay on it for the length of that silence."""

SLAVES_SHARE: Final = 0.25
MASTERS_SHARE: Final = 2.0
"""Below these shares of the threshold at 0 N the slave and the master are idle: the master below 0.05 N, 1 % of the
largest force at the device, and about what the force loop leaves as an error (0.03 N)."""


def slave_idle_below_n(law: WeberLaw) -> float:
    """Return below which force [N], true and held, the slave sends keepalives more rarely."""
    return SLAVES_SHARE * min(law.threshold_n(0.0), LARGEST_N)


def master_idle_below_n(law: WeberLaw) -> float:
    """Return below which applied force [N] the master waits longer for a sign of life."""
    return MASTERS_SHARE * min(law.threshold_n(0.0), LARGEST_N)
