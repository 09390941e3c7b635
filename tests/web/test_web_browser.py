"""The page in a real browser, beside real processes."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hapticnet.cli.pages import address_in, address_of
from hapticnet.runtime.processes import Child
from tests.web.observer import Observer

pytest.importorskip("playwright")
pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def urls() -> Iterator[dict[str, str]]:
    """Addresses of the two views of a run on loopback."""
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper:1"])
    master = None
    try:
        master = Child(["master", "--connect", slave.address(), "--page=127.0.0.1:0"])
        found: dict[str, str] = {}
        for line in master.lines():
            for view in ("watch", "operator"):
                if f"/{view}.html" in line:
                    found[view] = address_of(address_in(line)[0])
            if len(found) == 2:
                break
        yield found
    finally:
        for child in (master, slave):
            if child is not None:
                child.end()


class Tab:
    """A page in the browser, and what its console says."""

    def __init__(self, browser: Any, url: str) -> None:
        self.page = browser.new_page(viewport={"width": 900, "height": 640})
        self.complaints: list[str] = []
        self.page.on("console", lambda said: self.complaints.append(said.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("requestfailed", lambda request: self.complaints.append(request.url))
        self.page.goto(url)

    def press_on_scene(self) -> tuple[float, float]:
        """Put the pointer down on the scene, and return where."""
        box = self.page.locator("canvas#scene").bounding_box()
        x, y = box["x"] + box["width"] / 3, box["y"] + box["height"] / 4
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        return x, y


@pytest.fixture(scope="module")
def tab(urls: dict[str, str], chromium: Any) -> Tab:
    """A page that the tests share, because it takes seconds to open where nothing draws but the processor."""
    return Tab(chromium, urls["watch"])


@pytest.fixture
def observer(urls: dict[str, str]) -> Iterator[Observer]:
    """What is sent to a page during a test; each test begins with the hand free."""
    watching = Observer(urls["watch"])
    watching.until(lambda client: client.frames[-1]["state"] == 0 and client.last("ready").get("ready", False))
    yield watching
    watching.close()


def test_the_force_follows_the_pointer_and_escape_lets_go(tab: Tab, observer: Observer):
    x, y = tab.press_on_scene()
    observer.until(lambda client: client.last("hand")["holder"] == "another")
    for pixels in range(0, 400, 12):  # about 2 mm each
        tab.page.mouse.move(x, y + pixels)
        tab.page.wait_for_timeout(60)
        if observer.frame()["tip_m"] > 0.022:  # 2 mm into the first tissue, which breaks at 10 mm
            break
    tab.page.mouse.up()
    observer.until(lambda client: client.newest("held").min() > 0.3)
    observer.until(lambda client: client.newest("sensed").min() > 0.1)
    tab.page.keyboard.press("Escape")
    observer.until(lambda client: client.last("hand") == {"type": "hand", "holder": "nobody", "state": "free"})
    observer.until(lambda client: abs(client.newest("held")[-1]) < 0.03)
    assert tab.complaints == []
    assert observer.rows_have_no_gap()


def test_a_frozen_page_delays_no_tick_and_loses_the_hand(tab: Tab, observer: Observer):
    tab.press_on_scene()
    observer.until(lambda client: client.last("hand")["holder"] == "another")
    renderers = [pid for pid in descendants(os.getpid()) if b"--type=renderer" in command_line(pid)]
    assert renderers
    try:
        for pid in renderers:
            os.kill(pid, signal.SIGSTOP)
        for state in ("holding", "free"):
            observer.until(lambda client, state=state: client.last("hand")["state"] == state)
    finally:
        for pid in renderers:
            os.kill(pid, signal.SIGCONT)
    assert observer.rows_have_no_gap()
    assert observer.longest_pause_s() < 0.5
    tab.page.mouse.up()
    tab.page.locator("#hand-state", has_text="The needle is free").wait_for()
    assert tab.complaints == []


def command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:  # it has ended
        return b""


def descendants(pid: int) -> list[int]:
    """Return the processes that this one started, and those that they started."""
    children: list[int] = []
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children += map(int, tasks.read_text().split())
        except OSError:
            continue
    return children + [each for child in children for each in descendants(child)]
