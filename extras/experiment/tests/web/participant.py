"""A participant's page beside a rig that renders nothing, and clients that speak to it as pages do."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import aiohttp
from conducted import played

from hapticnet.node.procedures import Met
from hapticnet.operator.live import LiveHand
from hapticnet.protocol.states import Connected
from hapticnet.runtime.system import now_us
from hapticnet.runtime.udp import HostPort
from hapticnet.web.access import Access, listen_for_pages
from hapticnet.web.server import Server
from hapticnet_experiment.page import ParticipantPage, SeenHand
from hapticnet_experiment.plan import Plan
from hapticnet_experiment.rig import Activity, Meet, Outcome
from hapticnet_experiment.rows import OrderRow
from hapticnet_experiment.session import SessionSettings, conduct, open_session
from hapticnet_experiment.tasks import ORDER
from hapticnet_experiment.trial import Stimulus
from tests.web.rig import WITHIN_S, Client, connected

GRANT = object()


class StandInRig:
    """Performs each activity until it is stopped; a trial then counts as felt, unless `undelivered`."""

    def __init__(self, page: ParticipantPage, hand: SeenHand) -> None:
        self.running: Activity | None = None
        self.stopped_us: list[int] = []
        self.undelivered = 0
        self._page = page
        self._hand = hand
        self.deepest_m: float | None = None
        self._stop = asyncio.Event()

    def now_us(self) -> int:
        return now_us()

    async def wait(self, duration_us: int) -> None:
        await asyncio.sleep(duration_us / 1e6)

    def stop(self) -> None:
        self.stopped_us.append(now_us())
        self._stop.set()

    async def run(self, activity: Activity) -> Outcome:
        if isinstance(activity, Meet):
            return Met(0.5, 0.001)
        assert isinstance(activity, Stimulus)
        self.running = activity
        self._stop.clear()
        self._page.note(Connected(GRANT), now_us())  # type: ignore[arg-type]
        start_us = now_us()
        while not self._stop.is_set():
            self._hand.sample(now_us() - start_us)
            self._page.observe(now_us())
            await asyncio.sleep(0.002)
        self.running = None
        share = 0.1 if self.undelivered else 1.0
        self.undelivered = max(0, self.undelivered - 1)
        return played(activity, delivered=share)


@dataclass
class Session:
    """What a test may look at."""

    page: ParticipantPage
    rig: StandInRig
    hand: LiveHand
    access: Access
    rows: list[OrderRow]
    http: aiohttp.ClientSession
    said: list[str] = field(default_factory=list)

    def address(self, path: str) -> str:
        return f"http://{self.access.host}:{self.access.port}{path}"

    def open(self) -> "AbstractAsyncContextManager[Participant]":
        """Connect as the participant's page does."""
        return connected(self.http, self.access, "operator", Participant)

    def events(self) -> list[str]:
        return [row.event for row in self.rows]


class Participant(Client):
    """A participant, who may press the keys of the screen."""

    async def see(self, screen: str) -> dict[str, object]:
        """Wait until a screen is shown."""
        return await self.hear("task", screen=screen)

    async def press(self, key: str) -> None:
        await self.say("key", number=self.last("task")["number"], key=key)

    async def go_on(self, *screens: str) -> None:
        """Press Enter on each of these screens."""
        for screen in screens:
            await self.see(screen)
            await asyncio.sleep(float(str((await self.see(screen))["wait_s"])))
            await self.press("y" if screen == "consent" else "enter")

    async def push(self, position_m: float, there: Callable[[], bool]) -> None:
        """Take the hand and hold it at a position [m] until the needle is there."""
        await self.hear("ready", ready=True)
        await self.say("take")
        await self.hear("hand", holder="you")
        while not there():
            await self.move(position_m)
            await asyncio.sleep(0.02)

    async def answer(self, order: str = "213") -> None:
        """Type an order in a trial, as fast as possible, and confirm it."""
        await self.see("trial")
        await self.hear("ready", ready=True)
        for key in order:
            await self.press(key)
        await self.press("enter")


@asynccontextmanager
async def session(out: Path, plan: Plan, *, seed: int = 1) -> AsyncIterator[Session]:
    """Conduct an ordering task; it ends with the block at the latest."""
    hand = LiveHand()
    seen = SeenHand(hand)
    said: list[str] = []
    page = ParticipantPage(seen, "page", texts=plan.texts, masking_noise=plan.masking_noise, say=said.append)
    rig = StandInRig(page, seen)
    sock, access = listen_for_pages(HostPort("127.0.0.1", 0), ("operator",))
    server = Server(page, access, sock)
    settings = SessionSettings(
        task=ORDER, participant="01", session=1, seed=seed, plan=plan, out=out, observer=None, device="stand-in"
    )
    with open_session(settings, now_us()) as (flow, store):
        await server.start()
        await page.start()

        async def to_the_end() -> None:
            await conduct(flow, rig, page, store, date=lambda: "now")
            await page.stop()

        run = asyncio.ensure_future(to_the_end())
        try:
            async with aiohttp.ClientSession() as http, asyncio.timeout(WITHIN_S):
                yield Session(page, rig, hand, access, flow.rows, http, said)
        finally:
            run.cancel()
            await asyncio.gather(run, return_exceptions=True)
            await page.stop()
            await server.stop()
            sock.close()
