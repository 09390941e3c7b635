"""What every front has in which a person answers with keys."""

import asyncio
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, TypeAlias

from hapticnet.study.flow import Flow
from hapticnet.study.rig import Outcome, Rig
from hapticnet.study.rows import AnyRow


@dataclass(frozen=True, slots=True)
class Stop:
    """End the present activity, for `reason`."""

    reason: str


Said: TypeAlias = str | Stop
"""What a person says: a key, or that the activity must end."""


class KeyFront(ABC):
    """Shows screens and passes keys on."""

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

    @abstractmethod
    def _present(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen, if it has changed."""

    @abstractmethod
    async def _next(self) -> Said:
        """Return what the person says next."""
