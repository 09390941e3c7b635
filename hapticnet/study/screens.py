"""What a participant sees, and which keys answer it. Terminal, page and simulated observers show the same screens."""

import enum
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from hapticnet.study.texts import Texts

ENTER: Final = "enter"
ESCAPE: Final = "escape"
BACKSPACE: Final = "backspace"
TISSUE_KEYS: Final = ("1", "2", "3")
SAME: Final = "s"
DIFFERENT: Final = "d"
YES: Final = "y"
NO: Final = "n"
PREFER_NOT: Final = "0"
RATING_KEYS: Final = tuple("1234567")

READ_US: Final = 1_000_000
"""Time [µs] for which feedback stays at least: a second press of Enter was meant for the screen before it."""

Keys: TypeAlias = tuple[tuple[str, str], ...]  # keys that do something, with what they do


class ScreenKind(enum.StrEnum):
    """What a screen is for."""

    INSTRUCTIONS = "instructions"
    CONSENT = "consent"
    ABOUT = "about"
    MEET = "meet"
    PRACTICE = "practice"
    TRIAL = "trial"
    STIMULI = "stimuli"
    QUESTION = "question"
    MOMENT = "moment"
    FEEDBACK = "feedback"
    REPEAT = "repeat"
    RATING = "rating"
    BREAK = "break"
    STOPPED = "stopped"
    DONE = "done"


@dataclass(frozen=True, slots=True, kw_only=True)
class Screen:
    """One screen. The condition is never on it."""

    kind: ScreenKind
    title: str
    text: str
    keys: Keys = ()
    typed: str = ""  # of an answer
    remark: str = ""  # what was wrong with the last key
    progress: str = ""  # how far the session is; empty where that does not matter
    not_before_us: int | None = None  # time [µs] before which `ENTER` does nothing


def hash_of(text: str) -> str:
    """Return the SHA-256 of a text that was agreed to."""
    return hashlib.sha256(text.encode()).hexdigest()


def question_of(screen: Screen) -> Screen:
    """Return what a screen asks, whatever has been answered so far."""
    return replace(screen, keys=(), typed="", remark="")


KEYS: Final = {
    "go_on": ENTER, "confirm": ENTER, "undo": BACKSPACE, "end": ESCAPE, "stop": ESCAPE, "agree": YES, "disagree": NO,
    "same": SAME, "different": DIFFERENT, "first": "1", "second": "2", "prefer_not": PREFER_NOT,
}  # fmt: skip
"""The key of each action, by the name of its text."""


class Screens:
    """The screens in the words of a study."""

    def __init__(self, texts: Texts) -> None:
        self._words = texts.screens

    def make(
        self,
        kind: ScreenKind,
        name: str,
        *actions: str,
        text: str | None = None,
        choices: Iterable[tuple[str, str]] = (),
        **further: Any,
    ) -> Screen:
        """Return the screen with the title `name` and, unless another is given, the text that belongs to it.

        Its keys are those of `choices`, each with what it does, and then those of `actions`.
        """
        words = self._words
        return Screen(
            kind=kind,
            title=words[name],
            text=words[f"{name}_text"] if text is None else text,
            keys=(*choices, *((KEYS[action], words[action]) for action in actions)),
            **further,
        )

    def trial(self, typed: str, progress: str, *, untouched: int | None = None) -> Screen:
        """Return the screen of a trial; `untouched` is the tissue that must be touched before the answer is taken."""
        words = self._words
        return self.make(
            ScreenKind.TRIAL,
            "trial",
            *(["undo"] if typed else []),
            *(["confirm"] if len(typed) == len(TISSUE_KEYS) else []),
            "stop",
            choices=[(key, words["tissue"].format(number=key)) for key in TISSUE_KEYS if key not in typed],
            typed=typed,
            remark="" if untouched is None else words["untouched"].format(number=untouched),
            progress=progress,
        )

    def feedback(self, answered: str, right: str, now_us: int) -> Screen:
        """Return the feedback of a practice trial."""
        text = self._words["feedback"].format(order=" ".join(right), answer=" ".join(answered))
        name, read_us = "right" if answered == right else "wrong", now_us + READ_US
        return self.make(ScreenKind.FEEDBACK, name, "go_on", "end", text=text, not_before_us=read_us)

    def repeat(self, why: str, now_us: int) -> Screen:
        """Return the screen after a trial that does not count; `why` is one of the texts for that."""
        text = self._words["repeat_text"].format(why=why)
        return self.make(ScreenKind.REPEAT, "repeat", "go_on", "end", text=text, not_before_us=now_us + READ_US)

    def rating(self, progress: str) -> Screen:
        """Return the question for the quality of experience."""
        text = self._words["rating_text"].format(low=self._words["rating_low"], high=self._words["rating_high"])
        choices = [(key, "") for key in RATING_KEYS]
        return self.make(ScreenKind.RATING, "rating", "end", text=text, choices=choices, progress=progress)
