"""The gallery: its index, and the page of a demonstration beside a real master."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field, replace

from hapticnet.cli.given import MasterOptions, SlaveOptions
from hapticnet.errors import UnavailableError
from hapticnet.runtime.udp import HostPort
from hapticnet.web.access import Access, listen_for_pages
from hapticnet.web.gallery import Demonstration, Gallery, demonstrations
from hapticnet.web.messages import CloseCode
from hapticnet.web.server import static_files
from tests.web.rig import Client, Rig, connected, played, rig, until


@dataclass
class Shown:
    """A demonstration whose master is that of a rig."""

    url: str
    wanted: Demonstration
    is_over: bool = False

    def has_ended(self) -> bool:
        return self.is_over

    def end(self) -> None:
        self.is_over = True


@dataclass
class House:
    """A gallery beside a rig, and what it started."""

    around: Rig
    access: Access
    started: list[Shown] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    fault: str = ""

    def start(self, wanted: Demonstration) -> Shown:
        if self.fault:
            raise UnavailableError(self.fault)
        self.started.append(Shown(self.around.access.url("watch"), wanted))
        return self.started[-1]

    def visit(self, query: str, token: str = "") -> AbstractAsyncContextManager[Client]:
        access = replace(self.access, tokens={"watch": f"{token or self.access.tokens['watch']}&{query}"})
        return connected(self.around.http, access, "watch", Client)

    async def end_of(self, query: str, token: str = "") -> tuple[int | None, str]:
        """Return code and reason with which a page is sent away."""
        async with self.visit(query, token) as page:
            await until(lambda: page.closed)
            return page.socket.close_code, page.reason


@asynccontextmanager
async def theatre(unwatched_s: float = 30.0) -> AsyncIterator[House]:
    async with rig() as around:
        sock, access = listen_for_pages(HostPort("127.0.0.1", 0))
        house = House(around, access)
        gallery = Gallery(access, sock, house.start, house.said.append, unwatched_s=unwatched_s)
        await gallery.start()
        try:
            yield house
        finally:
            await gallery.stop()


@played
async def test_a_click_starts_a_demonstration_whose_page_moves_its_needle():
    async with theatre() as house, house.visit("show=2&variant=1") as page, house.visit("show=2&variant=1") as other:
        for query, seen in (("", 'id="shows"'), ("&show=1", 'id="plot"')):
            async with house.around.http.get(house.access.url("watch") + query) as answer:
                assert seen in await answer.text()
        assert (await page.hear("hello"))["view"] == "watch"
        await page.say("take")
        await page.hear("hand", holder="you")
        await page.move(0.025)
        await until(lambda: page.frames[-1]["tip_m"] > 0.005)
        await other.hear("hand", holder="another")
        assert [each.wanted for each in house.started] == [demonstrations()["2", "1"]]
    assert house.started[0].is_over


@played
async def test_another_demonstration_ends_the_first_and_says_so():
    async with theatre() as house:
        first = asyncio.ensure_future(house.end_of("show=1"))
        await until(lambda: len(house.started) == 1)
        async with house.visit("show=3") as second:
            await second.hear("hello")
            assert [each.is_over for each in house.started] == [True, False]
            house.around.stop.set()  # the master of both is the rig's
            assert await first == (CloseCode.MASTER_ENDED, "another demonstration was started")
            await until(lambda: second.closed)
            assert second.socket.close_code == CloseCode.MASTER_ENDED


@played
async def test_nobody_watches_and_the_demonstration_ends():
    async with theatre(unwatched_s=0.1) as house:
        async with house.visit("show=1") as page:
            await page.hear("hello")
            await asyncio.sleep(0.2)
            assert not house.started[0].is_over
        await until(lambda: house.started[0].is_over)
        async with house.visit("show=1") as page:
            await page.hear("hello")
        assert len(house.started) == 2


@played
async def test_a_start_that_fails_is_one_line_on_the_page_and_at_the_terminal_and_so_is_an_end():
    async with theatre() as house:
        house.fault = "'hapticnet slave' failed (1); it said: " + "é" * 200
        code, reason = await house.end_of("show=1")
        assert code == CloseCode.NOT_STARTED
        assert reason.startswith("the demonstration cannot be started: 'hapticnet slave' failed (1)")
        assert house.said == [f"demonstration 1 cannot be started: {house.fault}"]
        house.fault = ""
        assert (await house.end_of("variant=1"))[0] == CloseCode.NOT_STARTED
        assert (await house.end_of("show=1", "wrong"))[0] == CloseCode.WRONG_TOKEN
        async with house.visit("show=1") as page:
            await page.hear("hello")
            house.started[-1].is_over = True  # as if its slave was killed; its master still serves the page
            await until(lambda: page.closed)
            assert (page.socket.close_code, page.reason) == (CloseCode.MASTER_ENDED, "the demonstration has ended")


def test_every_demonstration_has_options_that_there_are_a_picture_and_words():
    for wanted in demonstrations().values():
        for given, kind in ((wanted.slave, SlaveOptions), (wanted.master, MasterOptions)):
            names = {each.removeprefix("--").replace("-", "_") for each in given if each.startswith("--")}
            assert names <= set(kind.__dataclass_fields__)
    files = static_files(("hapticnet.web",))
    shows = json.loads(files["gallery.json"][0])
    assert len(shows) == 5
    for each in shows:
        assert each["picture"] in files
        assert all(each[key] for key in ("title", "sentence", "try"))
