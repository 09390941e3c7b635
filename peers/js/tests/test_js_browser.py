"""The package in Chromium: the suite for every peer, a session over a data channel, and the pace of `run`."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from conformance import damage, golden
from conformance.child import Child, find_peers
from conformance.scenarios import MASTERS, SLAVES
from conformance.script import first_difference
from conformance.session import played
from hapticnet.codec.registry import every_codec

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

pytest.importorskip("playwright")
pytestmark = pytest.mark.browser
ORIGIN = "http://localhost"
POLICY = "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'"
every_codec()  # those of examples/literature, too


@pytest.fixture(scope="module")
def page(browser: "Browser", package: Path) -> "Page":
    """Open a page that gets its files from the package, as from a server with a strict policy."""
    opened = browser.new_page()

    def answer(route: "Route") -> None:
        path = package / route.request.url.removeprefix(f"{ORIGIN}/").removeprefix("examples/node_modules/hapticnet/")
        route.fulfill(path=path, headers={"Content-Security-Policy": POLICY}) if path.is_file() else route.abort()

    opened.route(f"{ORIGIN}/**", answer)
    opened.goto(f"{ORIGIN}/examples/page.html")
    return opened


class InPage(Child):
    """The package in a page, which answers the lines of the suite."""

    def __init__(self, page: "Page") -> None:
        self.peer = next(peer for peer in find_peers() if peer.folder.name == "js")
        self._page, self._later = page, []
        page.evaluate("async () => { answer = (await import('/tests/lines.mjs')).conversation(); }")
        self.features = dict(field.split("=", 1) for field in self.ask("features"))

    def _exchange(self, lines: Sequence[str]) -> list[str]:
        answers: list[str] = self._page.evaluate("lines => lines.map(answer)", list(lines))
        return answers


@pytest.fixture(scope="module")
def child(page: "Page") -> Iterator[InPage]:
    return InPage(page)


def test_the_decoder_of_every_codec_is_exact_to_the_bit(child: InPage):
    cases = [(name, first_difference(child, lines)) for name, _, lines in golden.decoders()]
    assert [case for case in cases if case[1] is not None] == []
    assert len(cases) >= 10


def test_a_master_says_and_refuses_what_the_vectors_say(child: InPage):
    for _, lines in (golden.conversation(), golden.sealed()):
        assert first_difference(child, lines) is None
    for name, lines in golden.refused_by_masters():
        assert first_difference(child, lines) is None, name
    for name, outcome, wanted in golden.traced(child):
        assert outcome == wanted, name


@pytest.mark.parametrize("name", ["bursts, axes 3", "sealed, disorder", "sealed, epochs", "codec merging"])
def test_a_master_sends_the_same_bytes_and_applies_the_same_forces(child: InPage, name: str):
    assert first_difference(child, played(MASTERS[name]).recorder.lines) is None


class InNode(Child):
    """The package in Node, with all that was said."""

    def __init__(self, package: Path) -> None:
        self.lines: list[str] = []
        self.answers: list[str] = []
        super().__init__(next(peer for peer in find_peers() if peer.folder == package), package)

    def _exchange(self, lines: Sequence[str]) -> list[str]:
        answers = super()._exchange(lines)
        self.lines += lines
        self.answers += answers
        return answers


@pytest.mark.parametrize("name", ["bursts", "sealed, slow"])
def test_a_slave_gives_the_same_answers_as_in_node_which_the_suite_compares(child: InPage, package: Path, name: str):
    in_node = InNode(package)
    played(SLAVES[name], in_node)
    in_node.end()
    assert len(in_node.lines) > 5_000
    assert child.batch(in_node.lines) == in_node.answers


def test_damaged_datagrams_change_nothing_that_they_do_not_change_at_hapticnets_master(child: InPage):
    assert first_difference(child, played(damage.MASTERS["damaged 0"]).recorder.lines) is None


def test_the_example_page_feels_a_spring_over_a_data_channel(page: "Page"):
    complaints: list[str] = []
    page.on("console", lambda said: complaints.append(said.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{ORIGIN}/examples/page.html")
    shown = page.locator("output")
    for y, force in ((50, "0.00 N"), (200, "3.00 N"), (50, "0.00 N")):
        page.mouse.move(50, y)
        shown.filter(has_text=force).wait_for(timeout=20_000)
    assert complaints == []


def test_run_keeps_a_period_that_a_chain_of_timers_could_not(page: "Page"):
    """Browsers make timers that are started by timers wait 4 ms."""
    ticks = page.evaluate(
        """async () => {
            const { Master, run } = await import("hapticnet");
            const transport = { send() {}, onmessage: null };
            let ticks = 0;
            const signal = AbortSignal.timeout(1000);
            await run(new Master(), { transport, hand: () => { ticks++; return [0]; }, feel() {}, signal });
            return ticks;
        }"""
    )
    assert ticks > 300
