"""What every front has in which a person answers with keys."""

import asyncio
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, TypeAlias

from hapticnet.study.flow import Flow
from hapticnet.study.rig import Outcome, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.screens import Screen, question_of


@dataclass(frozen=True, slots=True)
class Stop:
    """End the present activity, for `reason`."""

    reason: str


Said: TypeAlias = str | Stop
"""What a person says: a key, or that the activity must end."""


class KeyFront(ABC):
    """Shows screens and passes keys on.

    Attributes
    ----------
    number
        Number of the present question. A key counts for the question on which it was pressed and for no other.
    """

    def __init__(self) -> None:
        self.number = 0
        self._shown: Screen | None = None
        self._said: asyncio.Queue[tuple[int | None, Said]] = asyncio.Queue()

    def hear(self, said: Said, number: int | None = None) -> None:
        """Take what a person says, to the question of this number; None counts for any."""
        self._said.put_nowait((number, said))

    async def show(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen."""
        self._present(flow)

    async def key(self, flow: Flow[AnyRow]) -> str:
        """Return the next key; "" to look at the screen again."""
        self._present(flow)
        said = await self._next()
        return said if isinstance(said, str) else ""

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Pass keys on while an activity is performed; stop it when there is an answer."""
        listening = asyncio.ensure_future(self._next())
        try:
            while not activity.done():
                awaited: list[asyncio.Future[Any]] = [activity, listening]
                await asyncio.wait(awaited, return_when=asyncio.FIRST_COMPLETED)
                if listening.done() and not activity.done():
                    said = listening.result()
                    flow.deepest_m = rig.deepest_m
                    if isinstance(said, Stop):
                        flow.abort(said.reason, rig.now_us())
                    else:
                        flow.press(said, rig.now_us())
                    self._present(flow)
                    listening = asyncio.ensure_future(self._next())
                if flow.answered:
                    rig.stop()
                    break
            return await activity
        finally:
            listening.cancel()

    def _present(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen, if it has changed."""
        screen, before = flow.screen, self._shown
        if screen != before:
            self._shown = screen
            self.number += before is None or question_of(screen) != question_of(before)
            self._print(flow)

    async def _next(self) -> Said:
        """Return what the person says next."""
        while True:
            number, said = await self._said.get()
            if number is None or number == self.number:
                return said

    @abstractmethod
    def _print(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen, which has changed."""
