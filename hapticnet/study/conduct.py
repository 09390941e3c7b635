"""Conduct a session: let a front and a rig play a flow, and store each row before the next event begins."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Protocol

from hapticnet.errors import UnavailableError
from hapticnet.runtime.system import start_background
from hapticnet.study.flow import Flow
from hapticnet.study.rig import Outcome, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.store import Store


class Front(Protocol):
    """Who answers: a person at a terminal or a page, or a simulated observer."""

    async def show(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen."""
        ...

    async def key(self, flow: Flow[AnyRow]) -> str:
        """Return the next key; "" to look at the screen again."""
        ...

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Pass keys on while an activity is performed; return what came of it."""
        ...


async def conduct(
    flow: Flow[AnyRow],
    rig: Rig,
    front: Front,
    store: Store[AnyRow],
    *,
    date: Callable[[], str],
    version: str,
    on_outcome: Callable[[AnyRow, Outcome], None] | None = None,
    on_row: Callable[[AnyRow], None] = lambda _row: None,
) -> None:
    """Conduct a session to its end.

    Parameters
    ----------
    date
        Returns the date and time for the rows.
    on_outcome
        Called in a thread with each row that an activity left and with what came of the activity, once the row is
        stored.
    on_row
        Called with each row, also with one that was stored before the session went on.

    Raises
    ------
    FileError
        If a row cannot be stored.
    UnavailableError
        If the session cannot go on; what was answered is stored.
    """

    def save() -> list[AnyRow]:
        rows = [replace(row, date=date(), version=version) for row in flow.take_rows()]
        new = [row for row in rows if store.append(row)]
        for row in rows:
            on_row(row)
        return new

    save()
    while not flow.done:
        await front.show(flow)
        if flow.activity is None:
            key = await front.key(flow)
            if key:
                flow.press(key, rig.now_us())
            save()
            continue
        activity = asyncio.ensure_future(rig.run(flow.activity))
        try:
            outcome = await front.attend(flow, activity, rig)
        finally:
            if not activity.done():
                rig.stop()
                await activity
        save()  # what was noted meanwhile did not come of the activity
        flow.complete(outcome, rig.now_us())
        for row in save():
            if on_outcome is not None and row.event != "started":  # it is of the next activity
                await _beside(partial(on_outcome, row, outcome))  # the device goes on meanwhile
    await front.show(flow)
    if flow.declined:
        raise UnavailableError("the participant did not agree to take part; nothing was asked or measured")
    if flow.failure is not None:
        raise UnavailableError(f"{flow.failure}; everything answered is stored, go on with --resume")


async def _beside(work: Callable[[], None]) -> None:
    """Do work in a thread at normal priority, and wait for it without holding up the loop."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def body() -> None:
        error: BaseException | None = None
        try:
            work()
        except BaseException as caught:  # it is raised where it is awaited
            error = caught
        with suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(settle, error)

    def settle(error: BaseException | None) -> None:
        if done.cancelled():
            return
        if error is None:
            done.set_result(None)
        else:
            done.set_exception(error)

    start_background(body, "recording of a trial")
    await done
