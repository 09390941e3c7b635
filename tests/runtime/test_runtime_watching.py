"""Watchers: what fails is switched off and told once; the run goes on."""

import asyncio

import pytest

from hapticnet.errors import SettingsError
from hapticnet.runtime.watching import Watcher, Watchers


class Diary(Watcher[str]):
    """Write down what is called; raise where asked."""

    def __init__(self, name, raises=()):
        self.name, self.raises, self.pages = name, raises, []

    def _write(self, what, *page):
        self.pages.append((what, *page))
        if what in self.raises:
            raise SettingsError(f"{what} went wrong")

    async def start(self):
        self._write("start")

    def observe(self, now_us):
        self._write("observe", now_us)

    def note(self, event, now_us):  # noqa: ARG002
        self._write("note", event)

    def check(self, now_us):
        self._write("check", now_us)

    async def stop(self):
        self._write("stop")


class Blind(Watcher[str]):
    """Overrides nothing."""


def run(*watchers):
    said = []
    together = Watchers(watchers, said.append)

    async def play():
        await together.start()
        together.observe(1)
        together.note("hello", 2)
        together.check(3)
        together.observe(4)
        await together.stop()

    asyncio.run(play())
    return said, together


ALL = [("start",), ("observe", 1), ("note", "hello"), ("check", 3), ("observe", 4), ("stop",)]


def test_each_sees_everything_and_one_that_observes_nothing_costs_nothing_in_a_tick():
    diary, blind = Diary("diary"), Blind()
    said, together = run(diary, blind)
    assert diary.pages == ALL
    assert said == []
    assert together.observers == [diary.observe]


@pytest.mark.parametrize("raises", ["observe", "note", "check"])
def test_one_that_fails_is_told_once_and_never_called_again_but_stopped(raises):
    bad, good = Diary("page", raises=[raises]), Diary("diary")
    said, _ = run(bad, good)
    assert said == [f"page failed and is switched off: SettingsError: {raises} went wrong"]
    assert good.pages == ALL
    assert [page[0] for page in bad.pages].count(raises) == 1
    assert bad.pages[-1] == ("stop",)


def test_one_that_cannot_start_ends_the_run_before_it_begins_and_stops_the_others():
    good, bad = Diary("diary"), Diary("page", raises=["start"])
    with pytest.raises(SettingsError, match="start went wrong"):
        run(good, bad)
    assert good.pages == [("start",), ("stop",)]
