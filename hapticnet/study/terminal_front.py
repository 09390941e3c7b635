"""A participant at a terminal: screens as text, answers as keys."""

import shutil
import sys
from math import ceil
from textwrap import fill
from typing import Final, Self

from hapticnet.errors import UnavailableError
from hapticnet.runtime.system import now_us
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.key_front import KeyFront, Said
from hapticnet.study.keyboard import Keyboard
from hapticnet.study.rows import AnyRow
from hapticnet.study.screens import Screen
from hapticnet.study.texts import Texts

CLEAR: Final = "\x1b[2J\x1b[H"

WIDEST: Final = 80
"""Longest line: longer ones are hard to read."""


class TerminalFront(KeyFront):
    """Reads keys from a terminal, or from a pipe. Use it as a context manager.

    Parameters
    ----------
    texts
        What the participant reads.
    """

    def __init__(self, texts: Texts, stdin: int = 0) -> None:
        super().__init__()
        self._texts = texts
        self._keyboard = Keyboard(self._type, stdin)
        self._live = sys.stdout.isatty()

    def __enter__(self) -> Self:
        self._keyboard.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._keyboard.__exit__(*exception)

    def _type(self, key: str) -> None:
        # What comes through a pipe was written for all questions at once.
        self.hear(key, self.number if key and self._keyboard.is_terminal else None)

    async def _next(self) -> Said:
        said = await super()._next()
        if said == "":
            raise UnavailableError("the terminal was closed; everything answered is stored, go on with --resume")
        return said

    def _print(self, flow: Flow[AnyRow]) -> None:
        width = min(WIDEST, shutil.get_terminal_size().columns)
        text = "\n".join(fill(line, width) for line in in_lines(flow.screen, self._texts, now_us()))
        print((CLEAR if self._live else "") + text + "\n", flush=True)


def in_lines(screen: Screen, texts: Texts, now_us: int) -> list[str]:
    """Return a screen as the lines of a terminal, however long; `now_us` is the time [µs]."""
    names, words = texts.keys.model_dump(), texts.screens
    wait_s = 0 if screen.not_before_us is None else ceil(max(0, screen.not_before_us - now_us) / 1e6)
    lines = [screen.title, "", *screen.text.split("\n")]
    if screen.typed:
        lines += ["", words.answer.format(answer=" ".join(screen.typed))]
    if screen.remark:
        lines += ["", screen.remark]
    if screen.keys:
        lines.append("")
    for key, does in screen.keys:
        what = words.wait.format(what=does, seconds=wait_s) if key == screens.ENTER and wait_s > 1 else does
        lines.append(f"  {names.get(key, key)}: {what}" if what else f"  {key}")
    if screen.progress:
        lines += ["", screen.progress]
    return lines
