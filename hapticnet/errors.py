"""The exceptions of hapticnet.

Each message is written for a person: what is wrong, the value, and what is allowed.
"""

import traceback
from pathlib import Path
from typing import ClassVar, Final

from hapticnet.interrupts import is_ctrl_c

LONGEST_MESSAGE: Final = 1000  # most characters shown of a foreign exception's message


class HapticnetError(Exception):
    """Base class. The command line prints the message as one line and exits with `exit_code`."""

    exit_code: ClassVar[int] = 2


class SettingsError(HapticnetError):
    """A setting, flag or scene is invalid; the caller can correct it."""


class FileError(HapticnetError):
    """A file is missing, unreadable or malformed; the message names the file and, if known, line and column."""

    exit_code = 3


class SampleError(HapticnetError):
    """A position or force is not finite, out of range or has the wrong number of axes."""


class PeerError(HapticnetError):
    """Data from the network violates the protocol. It is counted and dropped; the error never leaves a node."""


class RefusedError(HapticnetError):
    """The slave refused the session and gave a reason."""

    exit_code = 5


class UnavailableError(HapticnetError):
    """A resource is unavailable: a port in use, an address of another host, an extra that is not installed."""

    exit_code = 4


class RunError(HapticnetError):
    """A run is over. A failure in it did not end it: code was too slow, or a helper process ended."""

    exit_code = 1


class UserCodeError(HapticnetError):
    """A scene, an operator or a device of the user raised an exception or returned something that cannot be used."""


def in_words(error: BaseException) -> str:
    """Return kind and message of an error, and its line in the user's code, on one line."""
    kind = type(error)
    name = kind.__name__ if kind.__module__ in ("builtins", __name__) else f"{kind.__module__}.{kind.__name__}"
    message = _message(error)
    if isinstance(error, UserCodeError):  # it names the class and the fault
        return message
    text = f"{name}: {message}" if message else name
    if isinstance(error, (SyntaxError, HapticnetError)):
        return text
    own = f"{Path(__file__).parent}/"
    places = [each for each in traceback.extract_tb(error.__traceback__) if not each.filename.startswith(("<", own))]
    return f"{text} ({Path(places[-1].filename).name}, line {places[-1].lineno})" if places else text


def printable(text: str) -> str:
    """Return a text for one line of a message: characters that would move a terminal's cursor become spaces and "?"."""
    return visible(" ".join(text.split()))


def visible(text: str) -> str:
    """Return a text with terminal control characters replaced by "?": it may come from an unknown peer."""
    return text if text.isprintable() else "".join(each if each.isprintable() else "?" for each in text)


def _message(error: BaseException) -> str:
    try:
        text = str(error)
    except BaseException as fault:  # a user's class may raise here, too
        if is_ctrl_c(fault):
            raise
        return f"its message raised {type(fault).__name__}"
    return shortened(printable(text[: 2 * LONGEST_MESSAGE]), LONGEST_MESSAGE)


def shortened(text: str, most: int) -> str:
    """Return a text of at most `most` characters."""
    return text if len(text) <= most else f"{text[: most - 3]}..."
