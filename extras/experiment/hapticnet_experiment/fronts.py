"""Fronts, which show the screens of a flow and pass it keys: a person at a terminal, or a simulated observer.

`page.ParticipantPage` is the front of a participant at a page in the browser.
"""

import asyncio
import math
import os
import shutil
import sys
import termios
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from textwrap import fill
from typing import Any, Final, Self, TypeAlias

import numpy as np

from hapticnet.errors import UnavailableError
from hapticnet.runtime.system import now_us
from hapticnet_experiment import screens
from hapticnet_experiment.flow import Flow
from hapticnet_experiment.observers import Look, Observer, ObserverSettings, contacts
from hapticnet_experiment.rig import Outcome, Rig
from hapticnet_experiment.rows import AnyRow
from hapticnet_experiment.screens import Screen, ScreenKind, Texts, question_of
from hapticnet_experiment.tasks import LimitsFlow
from hapticnet_experiment.trial import Played

KEY_NAMES: Final = {
    "\r": screens.ENTER,
    "\n": screens.ENTER,
    "\x1b": screens.ESCAPE,
    "\x7f": screens.BACKSPACE,
    "\b": screens.BACKSPACE,
}

CLEAR: Final = "\x1b[2J\x1b[H"
WIDEST: Final = 80  # longest line: longer ones are hard to read
READS_S: Final = 1.0  # time [s] that an observer spends on a screen without a question
COUNTED: Final = ("practice", "trial", "aborted", "repeated", "rating")  # new random numbers after these


class Keyboard:
    """Reads keys from a terminal as they are typed, or from a pipe. Use it as a context manager, on an event loop.

    `on_key` is called with each key, and with "" when there will be no more.
    """

    def __init__(self, on_key: Callable[[str], None], stdin: int = 0) -> None:
        self._on_key = on_key
        self._stdin = stdin
        self._before: list[Any] | None = None
        self._reads = False

    @property
    def is_terminal(self) -> bool:
        """Whether keys come from a terminal, one by one as a person presses them."""
        return self._before is not None

    def __enter__(self) -> Self:
        if os.isatty(self._stdin):
            self._before = termios.tcgetattr(self._stdin)
            tty.setcbreak(self._stdin)
        try:
            asyncio.get_running_loop().add_reader(self._stdin, self._read)
            self._reads = True
        except OSError:  # a file or nothing, which cannot be awaited
            self._on_key("")
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        if self._before is not None:
            termios.tcsetattr(self._stdin, termios.TCSADRAIN, self._before)

    def _stop(self) -> None:
        if self._reads:
            asyncio.get_running_loop().remove_reader(self._stdin)
            self._reads = False

    def _read(self) -> None:
        try:
            data = os.read(self._stdin, 64)
        except OSError:
            data = b""
        if not data:
            self._stop()
            self._on_key("")
            return
        text = data.decode("utf-8", "replace")
        if text.startswith("\x1b") and len(text) > 1:  # an arrow or function key
            return
        for character in text:
            self._on_key(KEY_NAMES.get(character, character.lower()))


@dataclass(frozen=True, slots=True)
class Stop:
    """End the present activity, for `reason`."""

    reason: str


Said: TypeAlias = str | Stop  # a person's input: a key, or a request to end the activity


class KeyFront(ABC):
    """Shows screens to a person, and passes keys on."""

    def __init__(self) -> None:
        self.number = 0  # number of the present question: a key counts only for the question on which it was pressed
        self._shown: Screen | None = None
        self._said: asyncio.Queue[tuple[int | None, Said]] = asyncio.Queue()

    def hear(self, said: Said, number: int | None = None) -> None:
        """Accept a person's input to the question of this number; None counts for any."""
        self._said.put_nowait((number, said))

    async def show(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen."""
        self._present(flow)

    async def key(self, flow: Flow[AnyRow]) -> str:
        """Return the next key; "" to look at the screen again."""
        self._present(flow)
        said = await self._next()
        return said if isinstance(said, str) else ""

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Pass on keys during an activity; stop it when there is an answer."""
        listening = asyncio.ensure_future(self._next())
        try:
            while not activity.done():
                awaited: list[asyncio.Future[Any]] = [activity, listening]
                await asyncio.wait(awaited, return_when=asyncio.FIRST_COMPLETED)
                if listening.done() and not activity.done():
                    said = listening.result()
                    flow.deepest_m = rig.deepest_m
                    if isinstance(said, Stop):
                        flow.abort(said.reason)
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

    def _present(self, flow: Flow[AnyRow]) -> None:
        screen, before = flow.screen, self._shown
        if screen != before:
            self._shown = screen
            self.number += before is None or question_of(screen) != question_of(before)
            self._print(flow)

    async def _next(self) -> Said:
        while True:
            number, said = await self._said.get()
            if number is None or number == self.number:
                return said

    @abstractmethod
    def _print(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen, which has changed."""


class TerminalFront(KeyFront, Keyboard):
    """A person at a terminal, or a pipe: screens as text, answers as keys. Use it as a context manager."""

    def __init__(self, texts: Texts, stdin: int = 0) -> None:
        KeyFront.__init__(self)
        Keyboard.__init__(self, self._type, stdin)
        self._texts = texts
        self._live = sys.stdout.isatty()

    def _type(self, key: str) -> None:
        # Input from a pipe is for all questions.
        self.hear(key, self.number if key and self.is_terminal else None)

    async def _next(self) -> Said:
        said = await super()._next()
        if said == "":
            raise UnavailableError("the terminal was closed; every answer is stored, continue with --resume")
        return said

    def _print(self, flow: Flow[AnyRow]) -> None:
        width = min(WIDEST, shutil.get_terminal_size().columns)
        text = "\n".join(fill(line, width) for line in in_lines(flow.screen, self._texts, now_us()))
        print((CLEAR if self._live else "") + text + "\n", flush=True)


def in_lines(screen: Screen, texts: Texts, now_us: int) -> list[str]:
    """Return a screen as the lines of a terminal, however long; `now_us` is the time [µs]."""
    words = texts.screens
    wait_s = 0 if screen.not_before_us is None else math.ceil(max(0, screen.not_before_us - now_us) / 1e6)
    lines = [screen.title, "", *screen.text.split("\n")]
    if screen.typed:
        lines += ["", words["answer"].format(answer=" ".join(screen.typed))]
    if screen.remark:
        lines += ["", screen.remark]
    if screen.keys:
        lines.append("")
    for key, does in screen.keys:
        what = words["wait"].format(what=does, seconds=wait_s) if key == screens.ENTER and wait_s > 1 else does
        lines.append(f"  {texts.keys.get(key, key)}: {what}" if what else f"  {key}")
    if screen.progress:
        lines += ["", screen.progress]
    return lines


class SimulatedFront:
    """A simulated observer instead of the participant: it answers every screen.

    Its random numbers depend on `key`, which is seed, participant and session, and on the number of trials.
    """

    def __init__(self, settings: ObserverSettings, rig: Rig, key: tuple[int, int, int]) -> None:
        self._settings = settings.of_participant(np.random.default_rng([*key[:2], 20]))
        self._rig = rig
        self._key = *key, 21
        self._felt: list[Look] = []

    async def show(self, flow: Flow[AnyRow]) -> None:
        """Show the present screen: an observer reads fast."""

    async def key(self, flow: Flow[AnyRow]) -> str:
        """Return the answer to a screen without an activity."""
        screen = flow.screen
        if screen.not_before_us is not None:
            await self._rig.wait(max(0, screen.not_before_us - self._rig.now_us()))
            return screens.ENTER
        if screen.kind is ScreenKind.CONSENT:
            return screens.YES
        observer = self._observer(flow)
        if screen.kind is ScreenKind.RATING:
            felt, self._felt = self._felt, []
            return str(observer.rate(felt))
        await self._take(observer.takes_s() if screen.kind is ScreenKind.QUESTION else READS_S)
        if screen.kind is ScreenKind.QUESTION and isinstance(flow, LimitsFlow) and flow.presented is not None:
            forces_n = flow.presented.sensed_n
            if screens.SAME in dict(screen.keys):
                return screens.DIFFERENT if observer.different(*forces_n) else screens.SAME
            return str(observer.stronger(*forces_n))
        return screens.ENTER

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Feel until the hand is at rest again, then answer."""
        outcome = await activity
        if flow.screen.kind is ScreenKind.TRIAL and isinstance(outcome, Played) and outcome.failure is None:
            observer = self._observer(flow)
            felt = contacts(outcome)
            self._felt += felt
            await self._take(observer.takes_s())
            for tissue in observer.order(felt):
                flow.press(str(tissue + 1), rig.now_us())
            flow.press(screens.ENTER, rig.now_us())
        return outcome

    def _observer(self, flow: Flow[Any]) -> Observer:
        trials = sum(row.event in COUNTED for row in flow.rows)
        return Observer(self._settings, np.random.default_rng([*self._key, trials]))

    async def _take(self, duration_s: float) -> None:
        if math.isfinite(duration_s):
            await self._rig.wait(round(1e6 * duration_s))


Front: TypeAlias = KeyFront | SimulatedFront
