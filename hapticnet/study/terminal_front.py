"""A participant at a terminal: screens as text, answers as keys."""

import asyncio
import os
import sys
import termios
import tty
from typing import Any, Final, Self

from hapticnet.errors import UnavailableError
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.rig import Outcome, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.screens import Screen

KEY_NAMES: Final = {
    "\r": screens.ENTER,
    "\n": screens.ENTER,
    "\x1b": screens.ESCAPE,
    "\x7f": screens.BACKSPACE,
    "\b": screens.BACKSPACE,
}
SPOKEN: Final = {screens.ENTER: "Enter", screens.ESCAPE: "Escape", screens.BACKSPACE: "Backspace"}

CLEAR: Final = "\x1b[2J\x1b[H"


class TerminalFront:
    """Reads keys from a terminal, or from a pipe. Use it as a context manager."""

    def __init__(self, stdin: int = 0) -> None:
        self._stdin = stdin
        self._keys: asyncio.Queue[str] = asyncio.Queue()
        self._before: list[Any] | None = None
        self._shown: Screen | None = None
        self._live = sys.stdout.isatty()

    def __enter__(self) -> Self:
        if os.isatty(self._stdin):
            self._before = termios.tcgetattr(self._stdin)
            tty.setcbreak(self._stdin)
        asyncio.get_running_loop().add_reader(self._stdin, self._read)
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.get_running_loop().remove_reader(self._stdin)
        if self._before is not None:
            termios.tcsetattr(self._stdin, termios.TCSADRAIN, self._before)

    async def show(self, flow: Flow[AnyRow]) -> None:
        """Print the present screen, if it has changed."""
        self._print(flow.screen)

    async def key(self, flow: Flow[AnyRow]) -> str:
        """Return the next key."""
        self._print(flow.screen)
        return await self._next()

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Pass keys on while an activity is performed; stop it when there is an answer."""
        pressed = asyncio.ensure_future(self._next())
        try:
            while not activity.done():
                awaited: list[asyncio.Future[Any]] = [activity, pressed]
                await asyncio.wait(awaited, return_when=asyncio.FIRST_COMPLETED)
                if pressed.done() and not activity.done():
                    flow.press(pressed.result(), rig.now_us())
                    self._print(flow.screen)
                    pressed = asyncio.ensure_future(self._next())
                if flow.answered:
                    rig.stop()
                    break
            return await activity
        finally:
            pressed.cancel()

    async def _next(self) -> str:
        key = await self._keys.get()
        if key == "":
            raise UnavailableError("the terminal was closed; everything answered is stored, go on with --resume")
        return key

    def _read(self) -> None:
        try:
            data = os.read(self._stdin, 64)
        except OSError:
            data = b""
        if not data:
            asyncio.get_running_loop().remove_reader(self._stdin)
            self._keys.put_nowait("")
            return
        text = data.decode("utf-8", "replace")
        if text.startswith("\x1b") and len(text) > 1:  # an arrow or function key
            return
        for character in text:
            self._keys.put_nowait(KEY_NAMES.get(character, character.lower()))

    def _print(self, screen: Screen) -> None:
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
