"""A simulated observer in the place of the participant: it answers every screen."""

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.study import screens
from hapticnet.study.cues import Look, looks
from hapticnet.study.flow import Flow
from hapticnet.study.limits_flow import LimitsFlow
from hapticnet.study.observers import Observer, ObserverSettings
from hapticnet.study.rig import Outcome, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.screens import ScreenKind
from hapticnet.study.trial import Played

if TYPE_CHECKING:
    import asyncio

READS_US: Final = 1_000_000
"""Time [µs] that an observer takes for a screen without a question."""


COUNTED: Final = ("practice", "trial", "aborted", "repeated", "rating")
"""Events after which an observer draws anew."""


class SimulatedFront:
    """Answers for an observer.

    The random numbers of an answer depend on the seed and on how many trials there were, so a session that goes on
    after a crash draws what it would have drawn.

    Parameters
    ----------
    settings
        The observer; differences between participants are drawn from the seed.
    waits
        Whether an observer takes its time, which costs nothing in virtual time.
    """

    def __init__(
        self, settings: ObserverSettings, rig: Rig, *, seed: int, participant: int, session: int, waits: bool
    ) -> None:
        self._settings = settings.of_participant(np.random.default_rng([seed, participant, 20]))
        self._rig = rig
        self._key = seed, participant, session, 21
        self._waits = waits
        self._felt: list[Look] = []

    async def show(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen: an observer reads fast."""

    async def key(self, flow: Flow[AnyRow]) -> str:
        """Return the answer to a screen without an activity."""
        screen = flow.screen
        if screen.not_before_us is not None:
            await self._rig.wait(max(0, screen.not_before_us - self._rig.now_us()))
            return screens.ENTER
        if screen.kind is ScreenKind.CONSENT:
            return screens.YES
        observer = self._observer(flow)
        if screen.kind is ScreenKind.RATING:
            felt, self._felt = self._felt, []
            return str(observer.rate(felt))
        await self._take(observer.takes_s() if screen.kind is ScreenKind.QUESTION else READS_US / 1e6)
        if screen.kind is ScreenKind.QUESTION and isinstance(flow, LimitsFlow) and flow.presented is not None:
            forces_n = flow.presented.sensed_n
            if screens.SAME in dict(screen.keys):
                return screens.DIFFERENT if observer.different(*forces_n) else screens.SAME
            return str(observer.stronger(*forces_n))
        return screens.ENTER

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Feel until the hand is at rest again, then answer."""
        outcome = await activity
        if flow.screen.kind is ScreenKind.TRIAL and isinstance(outcome, Played) and outcome.failure is None:
            observer = self._observer(flow)
            felt = contacts(outcome)
            self._felt += felt
            await self._take(observer.takes_s())
            for tissue in observer.order(felt):
                flow.press(str(tissue + 1), rig.now_us())
            flow.press(screens.ENTER, rig.now_us())
        return outcome

    def _observer(self, flow: Flow[Any]) -> Observer:
        return Observer(
            self._settings, np.random.default_rng([*self._key, sum(row.event in COUNTED for row in flow.rows)])
        )

    async def _take(self, duration_s: float) -> None:
        if self._waits and math.isfinite(duration_s):
            await self._rig.wait(round(1e6 * duration_s))


def contacts(played: Played) -> list[Look]:
    """Return what the finger felt of each contact of a trial."""
    ticks = played.ticks
    return looks(
        ticks["t_us"],
        ticks["position_m"],
        ticks["held_n"],
        ticks["sensed_n"],
        surfaces_m=played.stimulus.surfaces_m,
        breach_depths_m=[tissue.breach_depth_m for tissue in played.stimulus.tissues],
    )
