"""A whole session of the experiment on the participant's page, in a real browser and with real processes."""

import csv
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hapticnet.cli.pages import address_in, address_of
from hapticnet.runtime.processes import Child

pytest.importorskip("playwright")
pytestmark = pytest.mark.browser

ORDER_PLAN = """
name = "short"
[order]
breach_forces_n = [1.0, 1.6, 2.2]
gap_m = 0.003
trials = 1
practice = 1
practice_pairs = 0
practice_rounds = 1
break_s = 0.0
least_delivered = 0.02
most_attempts = 20
[[condition]]
name = "secret"
"""


class Participant:
    """Somebody at the page, who does what each screen asks."""

    def __init__(self, browser: Any, url: str) -> None:
        self.page = browser.new_page(viewport={"width": 1280, "height": 720})
        self.complaints: list[str] = []
        self.page.on("console", lambda said: self.complaints.append(said.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)

    def screen(self, *awaited: str) -> str:
        """Return the present screen, once it is one of these; go on after trials in vain."""
        for _ in range(1500):
            shown = self.page.evaluate("document.body.dataset.screen")
            if shown in awaited:
                return str(shown)
            if shown == "repeat":
                self.page.keyboard.press("Enter")
            self.page.wait_for_timeout(20)
        raise AssertionError(f"waited for {awaited}, but the page shows {shown}")

    def leave(self, screen: str) -> None:
        """Wait until another screen is shown."""
        self.page.wait_for_function("(screen) => document.body.dataset.screen !== screen", arg=screen)

    def click(self, name: str) -> None:
        self.page.get_by_role("button", name=re.compile(name)).click()

    def push(self) -> None:
        """Push the needle slowly through all tissues, with the keyboard."""
        self.page.locator("#hand-state", has_text="Press on the picture").wait_for()
        for _ in range(4):
            self.page.keyboard.press("PageDown")
        self.page.wait_for_timeout(500)
        self.page.keyboard.down("Shift")
        self.page.keyboard.down("ArrowDown")
        self.page.wait_for_timeout(1900)
        self.page.keyboard.up("ArrowDown")
        self.page.keyboard.up("Shift")


@contextmanager
def session(folder: Path) -> Iterator[tuple[Child, str]]:
    """Start a session and yield it with the address of its page."""
    (folder / "plan.toml").write_text(ORDER_PLAN)
    arguments = ["experiment", "order", "--participant", "01", "--plan", str(folder / "plan.toml")]
    child = Child([*arguments, "--out-dir", str(folder / "study"), "--page=127.0.0.1:0"])
    try:
        lines = child.lines()
        yield child, next(address_of(file) for line in lines if (file := address_in(line)[0]))
    finally:
        child.end()


def rows(folder: Path) -> list[dict[str, str]]:
    table = next((folder / "study").rglob("*_beh.tsv"))
    with table.open() as file:
        return list(csv.DictReader(file, delimiter="\t"))


def test_a_session_is_conducted_on_the_page_and_survives_a_reload(chromium: Any, tmp_path: Path):
    with session(tmp_path) as (child, url):
        person = Participant(chromium, url)
        person.screen("instructions")
        person.click("Go on")
        person.screen("consent")
        person.click("I agree")
        person.screen("practice")
        person.page.keyboard.press("Enter")
        person.screen("trial")
        person.page.locator("#hand-state", has_text="Press on the picture").wait_for()
        person.page.keyboard.press("PageDown")
        person.page.reload()
        person.page.get_by_role("heading", name="This one comes again").wait_for()
        person.screen("trial")

        other = Participant(chromium, url)
        other.page.get_by_text("The session is open on another page").wait_for()
        other.page.close()

        while person.screen("trial", "feedback") == "trial":
            person.push()
            for tissue in "213":
                person.click(f"Tissue {tissue}")
            person.click("Confirm")
            person.leave("trial")
        assert "From the softest to the hardest" in person.page.locator("#task .text").inner_text()
        person.click("^Go on")  # once it can be pressed
        while person.screen("trial", "rating") == "trial":
            person.push()
            for key in ("3", "1", "Backspace", "2", "1", "Enter"):
                person.page.keyboard.press(key)
            person.leave("trial")
        person.click("^6$")
        person.page.get_by_role("heading", name="Thank you").wait_for()
        child.finish()
        person.page.get_by_text("Finished").wait_for()
        assert person.page.get_by_role("heading", name="Thank you").is_visible()
        assert person.complaints == []

    events = {row["event"] for row in rows(tmp_path)}
    assert {"begin", "consent", "meet", "practice", "trial", "rating", "aborted", "end"} <= events
    assert any(row["reason"] == "the page was closed" for row in rows(tmp_path))
    answered = next(row for row in rows(tmp_path) if row["event"] == "trial")
    assert (answered["order_answered"], answered["key_resp.keys"]) == ("321", "31<21")
    assert float(answered["peak_held_3_n"]) > 0.9
