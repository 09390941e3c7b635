"""What a participant sees, and which keys answer it. Terminal, page and simulated observers show the same screens."""

import enum
import hashlib
from collections.abc import Sequence
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

Keys: TypeAlias = tuple[tuple[str, str], ...]
"""Keys that do something, with what they do."""


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


class Screens:
    """The screens in the words of a study."""

    def __init__(self, texts: Texts) -> None:
        self._texts = texts
        self._words = words = texts.screens
        self._end = (ESCAPE, words["end"])
        self._next = ((ENTER, words["go_on"]), self._end)
        self._stop = (ESCAPE, words["stop"])

    def _screen(
        self, kind: ScreenKind, name: str, keys: Keys = (), *, text: str | None = None, **further: Any
    ) -> Screen:
        """Return a screen with the title `name` and, unless another is given, the text that belongs to it."""
        text = self._words[f"{name}_text"] if text is None else text
        return Screen(kind=kind, title=self._words[name], text=text, keys=keys, **further)

    def instructions(self, text: str, *, again: bool) -> Screen:
        """Return the first screen of a session, or of one that goes on."""
        return self._screen(ScreenKind.INSTRUCTIONS, "again" if again else "instructions", self._next, text=text)

    def consent(self) -> Screen:
        """Return the screen that asks for consent."""
        keys = (YES, self._words["agree"]), (NO, self._words["disagree"])
        return self._screen(ScreenKind.CONSENT, "consent", keys, text=self._texts.agreement)

    def about(self, text: str, choices: Sequence[str]) -> Screen:
        """Return a question about the participant."""
        answers = tuple((str(number), choice) for number, choice in enumerate(choices, start=1))
        keys = (*answers, (PREFER_NOT, self._words["prefer_not"]), self._end)
        return self._screen(ScreenKind.ABOUT, "about", keys, text=text)

    def meeting(self) -> Screen:
        """Return the screen while the platform meets the finger."""
        return self._screen(ScreenKind.MEET, "meet", (self._stop,))

    def practice(self, round_number: int) -> Screen:
        """Return the screen before a round of practice."""
        text = self._words["practice_again" if round_number else "practice_text"]
        return self._screen(ScreenKind.PRACTICE, "practice", self._next, text=text)

    def trial(self, typed: str, progress: str, *, untouched: int | None = None) -> Screen:
        """Return the screen of a trial; `untouched` is the tissue that must be touched before the answer is taken."""
        words = self._words
        keys = [(key, words["tissue"].format(number=key)) for key in TISSUE_KEYS if key not in typed]
        if typed:
            keys.append((BACKSPACE, words["undo"]))
        if len(typed) == len(TISSUE_KEYS):
            keys.append((ENTER, words["confirm"]))
        remark = "" if untouched is None else words["untouched"].format(number=untouched)
        keys.append(self._stop)
        return self._screen(ScreenKind.TRIAL, "trial", tuple(keys), typed=typed, remark=remark, progress=progress)

    def moment(self, *, halted: bool) -> Screen:
        """Return the screen while what was performed comes to its end."""
        return self._screen(ScreenKind.MOMENT, "moment", text=self._words["halt_text" if halted else "moment_text"])

    def stimuli(self, progress: str) -> Screen:
        """Return the screen while two forces are presented."""
        return self._screen(ScreenKind.STIMULI, "stimuli", (self._stop,), progress=progress)

    def same_or_different(self, progress: str) -> Screen:
        """Return the question of the method of limits."""
        keys = (SAME, self._words["same"]), (DIFFERENT, self._words["different"]), self._end
        return self._screen(ScreenKind.QUESTION, "ascending", keys, progress=progress)

    def which_stronger(self, progress: str) -> Screen:
        """Return the question of the forced choice."""
        keys = ("1", self._words["first"]), ("2", self._words["second"]), self._end
        return self._screen(ScreenKind.QUESTION, "choice", keys, progress=progress)

    def feedback(self, answered: str, right: str, now_us: int) -> Screen:
        """Return the feedback of a practice trial."""
        text = self._words["feedback"].format(order=" ".join(right), answer=" ".join(answered))
        name, read_us = "right" if answered == right else "wrong", now_us + READ_US
        return self._screen(ScreenKind.FEEDBACK, name, self._next, text=text, not_before_us=read_us)

    def repeat(self, why: str, now_us: int) -> Screen:
        """Return the screen after a trial that does not count; `why` is one of the texts for that."""
        text = self._words["repeat_text"].format(why=why)
        return self._screen(ScreenKind.REPEAT, "repeat", self._next, text=text, not_before_us=now_us + READ_US)

    def rating(self, progress: str) -> Screen:
        """Return the question for the quality of experience."""
        words, keys = self._words, (*((key, "") for key in RATING_KEYS), self._end)
        text = words["rating_text"].format(low=words["rating_low"], high=words["rating_high"])
        return self._screen(ScreenKind.RATING, "rating", keys, text=text, progress=progress)

    def pause(self, not_before_us: int, progress: str) -> Screen:
        """Return the screen of a break."""
        return self._screen(ScreenKind.BREAK, "pause", self._next, progress=progress, not_before_us=not_before_us)

    def done(self) -> Screen:
        """Return the last screen."""
        return self._screen(ScreenKind.DONE, "done")

    def stopped(self) -> Screen:
        """Return the screen of a session that cannot go on now; why is for the experimenter."""
        return self._screen(ScreenKind.STOPPED, "interrupted")
