"""The first touch of a finger, before a master asks for a session.

A platform that was never pressed against its finger is retracted and does not know where it is or how stiff. The first
force of a session would then be felt late: the platform searches at 10 mm/s, and presses with caution.
"""

from typing import Final

from hapticnet.errors import UnavailableError
from hapticnet.node.fingertip import FingerMet, FingerNotMet, Fingertip
from hapticnet.node.procedures import Meeting

FIRST_TOUCH_N: Final = 1.0
FIRST_TOUCH_US: Final = 500_000
"""Force [N] and duration [µs] of the first touch. The stiffness shows in how the force rises: less force would leave it
uncertain. A fifth of the largest force, and half of what a finger is tuned with."""


class FirstTouch:
    """Meet the finger, and tell how.

    Attributes
    ----------
    outcome
        What came of it; None while it goes on.
    """

    def __init__(self, fingertip: Fingertip) -> None:
        self.outcome: FingerMet | FingerNotMet | None = None
        self._fingertip = fingertip
        force_n = min(FIRST_TOUCH_N, fingertip.largest_n)
        self._meeting = Meeting(fingertip, force_n=force_n, press_us=FIRST_TOUCH_US)

    def tick(self, now_us: int) -> FingerMet | FingerNotMet | None:
        """Press one step; return the outcome once it is over. The device may raise anything."""
        try:
            if self._meeting.tick(now_us):
                met = self._meeting.result()
                stiffness_n_m = 1.0 / self._fingertip.controller.finger.compliance_m_n
                self.outcome = FingerMet(met.contact_m, stiffness_n_m)
        except UnavailableError as error:
            self.outcome = FingerNotMet(str(error))
        return self.outcome
