"""The page in a real browser, beside real processes."""

import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticnet.cli.pages import address_in, address_of
from hapticnet.recordings.text import read_csv
from hapticnet.runtime.processes import Child

pytest.importorskip("playwright")
pytestmark = pytest.mark.browser
FREE = "The needle is free"
A_FORCE = re.compile(r"^(0\.[1-9]|[1-9])")
SHOWN_M = 0.101  # height of the scene


@contextmanager
def recorded_run(file: Path) -> Iterator[str]:
    """Yield the address of the page of a run on loopback, and record it."""
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper:1"])
    master = None
    try:
        master = Child(["master", "--connect", slave.address(), "--page=127.0.0.1:0", "--record", str(file)])
        yield next(address_of(address_in(line)[0]) for line in master.lines() if "/watch.html" in line)
    finally:
        for child in (master, slave):
            if child is not None:
                child.end()


def test_the_force_follows_the_pointer_and_a_frozen_page_delays_no_tick_and_loses_the_hand(
    chromium: Any, tmp_path: Path
):
    with recorded_run(tmp_path / "run.csv") as url:
        move_and_freeze(chromium, url)
    ticks = read_csv(tmp_path / "run.csv")
    assert ticks["held_n"].max() > 0.3
    assert ticks["sensed_n"].max() > 0.1
    assert np.diff(ticks["t_us"]).max() < 500_000
    assert ticks["position_m"][-1] == 0.0


def move_and_freeze(chromium: Any, url: str) -> None:
    """Push the needle into the first tissue and let it go, then take it again on a page that freezes."""
    page = chromium.new_page(viewport={"width": 900, "height": 640})
    complaints: list[str] = []
    page.on("console", lambda said: complaints.append(said.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", lambda request: complaints.append(request.url))
    page.goto(url)
    state = page.locator("#hand-state")
    state.filter(has_text=FREE).wait_for()
    box = page.locator("canvas#scene").bounding_box()
    x, y = box["x"] + box["width"] / 3, box["y"] + box["height"] / 4
    page.mouse.move(x, y)
    page.mouse.down()
    # One motion into the middle of the first tissue, which begins at 20 mm and breaks at 30; the needle follows in its
    # own time. A pointer that goes on until the page shows a depth would be ahead of what a busy machine has drawn.
    page.mouse.move(x, y + 0.025 / SHOWN_M * box["height"])
    # The platform first searches for the finger, as long as it takes.
    page.locator('[data-line="sensed"] output').filter(has_text=A_FORCE).wait_for(state="attached")
    page.keyboard.press("Escape")
    state.filter(has_text=FREE).wait_for()
    page.mouse.up()

    page.mouse.down()
    state.filter(has_not_text=FREE).wait_for()
    page.mouse.move(x, y + 60)
    renderers = [pid for pid in descendants(os.getpid()) if b"--type=renderer" in command_line(pid)]
    assert renderers
    try:
        for pid in renderers:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(2.0)  # longer than a silent page keeps the hand
    finally:
        for pid in renderers:
            os.kill(pid, signal.SIGCONT)
    page.mouse.up()
    state.filter(has_text=FREE).wait_for()
    assert complaints == []


def test_the_gallery_is_walked_through_by_clicks(chromium: Any):
    gallery = Child(["gallery", "--page=127.0.0.1:0"])
    try:
        url = next(address_of(address_in(line)[0]) for line in gallery.lines() if "/watch.html" in line)
        page = chromium.new_page(viewport={"width": 1280, "height": 720})
        complaints: list[str] = []
        page.on("console", lambda said: complaints.append(said.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(url)
        assert page.locator("#shows a").count() == 5
        page.get_by_role("link", name="Three tissues").click()
        connected = page.locator("#link-state").filter(has_text="Connected")
        connected.wait_for()
        page.get_by_role("link", name="Everything sent").click()
        page.locator("#codec-help").filter(has_text="Every force is sent").wait_for()
        assert page.get_by_role("link", name="Everything sent").get_attribute("aria-current") == "true"
        page.get_by_role("link", name="Next: A force that comes late").click()
        page.get_by_role("heading", name="2 of 5: A force that comes late").wait_for()
        page.get_by_role("link", name="All demonstrations").click()
        page.locator("#shows a").first.wait_for()
        assert complaints == []
        page.close()
    finally:
        gallery.end()
    assert [pid for pid in descendants(os.getpid()) if b"hapticnet\0" in command_line(pid)] == []


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
