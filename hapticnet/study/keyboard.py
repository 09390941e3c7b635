"""Keys of a terminal."""

import asyncio
import os
import termios
import tty
from collections.abc import Callable
from typing import Any, Final, Self

from hapticnet.study import screens

KEY_NAMES: Final = {
    "\r": screens.ENTER,
    "\n": screens.ENTER,
    "\x1b": screens.ESCAPE,
    "\x7f": screens.BACKSPACE,
    "\b": screens.BACKSPACE,
}


class Keyboard:
    """Reads keys from a terminal as they are typed, or from a pipe. Use it as a context manager, on an event loop.

    Parameters
    ----------
    on_key
        Called with each key; with "" when there will be no more.
    stdin
        File descriptor.
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
        except OSError:  # a file, or nothing: it cannot be waited for
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
