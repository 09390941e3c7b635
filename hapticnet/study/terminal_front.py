"""A participant at a terminal: screens as text, answers as keys."""

import asyncio
import sys
from typing import TYPE_CHECKING, Final, Self

from hapticnet.errors import UnavailableError
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.key_front import KeyFront
from hapticnet.study.keyboard import Keyboard
from hapticnet.study.rows import AnyRow

if TYPE_CHECKING:
    from hapticnet.study.screens import Screen

SPOKEN: Final = {screens.ENTER: "Enter", screens.ESCAPE: "Escape", screens.BACKSPACE: "Backspace"}

CLEAR: Final = "\x1b[2J\x1b[H"


class TerminalFront(KeyFront):
    """Reads keys from a terminal, or from a pipe. Use it as a context manager."""

    def __init__(self, stdin: int = 0) -> None:
        self._keys: asyncio.Queue[str] = asyncio.Queue()
        self._keyboard = Keyboard(self._keys.put_nowait, stdin)
        self._shown: Screen | None = None
        self._live = sys.stdout.isatty()

    def __enter__(self) -> Self:
        self._keyboard.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._keyboard.__exit__(*exception)

    async def _next(self) -> str:
        key = await self._keys.get()
        if key == "":
            raise UnavailableError("the terminal was closed; everything answered is stored, go on with --resume")
        return key

    def _present(self, flow: Flow[AnyRow]) -> None:
        screen = flow.screen
        if screen == self._shown:
            return
        self._shown = screen
        lines = [screen.title, "", screen.text]
        if screen.typed:
            lines += ["", f"Your answer: {' '.join(screen.typed)}"]
        if screen.keys:
            lines += ["", *(f"  {SPOKEN.get(key, key)}: {what}" if what else f"  {key}" for key, what in screen.keys)]
        if screen.progress:
            lines += ["", screen.progress]
        print((CLEAR if self._live else "") + "\n".join(lines) + "\n", flush=True)
