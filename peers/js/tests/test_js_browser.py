"""The package in Chromium: a session over a data channel, and the pace of `run`."""

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

pytest.importorskip("playwright")
pytestmark = pytest.mark.browser
ORIGIN = "http://localhost"
POLICY = "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'"


@pytest.fixture
def page(browser: "Browser", package: Path) -> "Page":
    """Open a page that gets its files from the package, as from a server with a strict policy."""
    opened = browser.new_page()

    def answer(route: "Route") -> None:
        path = package / route.request.url.removeprefix(f"{ORIGIN}/").removeprefix("examples/node_modules/hapticnet/")
        route.fulfill(path=path, headers={"Content-Security-Policy": POLICY}) if path.is_file() else route.abort()

    opened.route(f"{ORIGIN}/**", answer)
    return opened


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
    page.goto(f"{ORIGIN}/examples/page.html")
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
