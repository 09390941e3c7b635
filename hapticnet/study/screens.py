"""What a participant sees, and which keys answer it. Terminal, page and simulated observers show the same screens."""

import enum
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

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
    """One screen.

    Attributes
    ----------
    title, text
        What to show. The condition is never among it.
    keys
        Keys that do something, with what they do.
    typed
        What has been typed of an answer.
    remark
        What was wrong with the last key.
    progress
        How far the session is; empty where that does not matter.
    not_before_us
        Time [µs] before which `ENTER` does nothing; None if it works at once.
    """

    kind: ScreenKind
    title: str
    text: str
    keys: tuple[tuple[str, str], ...] = ()
    typed: str = ""
    remark: str = ""
    progress: str = ""
    not_before_us: int | None = None


def hash_of(text: str) -> str:
    """Return the SHA-256 of a text that was agreed to."""
    return hashlib.sha256(text.encode()).hexdigest()


def question_of(screen: Screen) -> Screen:
    """Return what a screen asks, whatever has been answered so far."""
    return replace(screen, keys=(), typed="", remark="")


class Screens:
    """The screens in the words of a study.

    Parameters
    ----------
    texts
        The words.
    """

    def __init__(self, texts: Texts) -> None:
        self._texts = texts
        self._words = words = texts.screens
        self._end = (ESCAPE, words.end)
        self._next = ((ENTER, words.go_on), self._end)
        self._stop = (ESCAPE, words.stop)

    def instructions(self, text: str, *, again: bool) -> Screen:
        """Return the first screen of a session, or of one that goes on."""
        words = self._words
        title = words.again if again else words.instructions
        return Screen(kind=ScreenKind.INSTRUCTIONS, title=title, text=text, keys=self._next)

    def consent(self) -> Screen:
        """Return the screen that asks for consent."""
        words = self._words
        keys = (YES, words.agree), (NO, words.disagree)
        return Screen(kind=ScreenKind.CONSENT, title=words.consent, text=self._texts.consent.whole, keys=keys)

    def about(self, text: str, choices: Sequence[str]) -> Screen:
        """Return a question about the participant."""
        answers = tuple((str(number), choice) for number, choice in enumerate(choices, start=1))
        keys = (*answers, (PREFER_NOT, self._words.prefer_not), self._end)
        return Screen(kind=ScreenKind.ABOUT, title=self._words.about, text=text, keys=keys)

    def meeting(self) -> Screen:
        """Return the screen while the platform meets the finger."""
        words = self._words
        return Screen(kind=ScreenKind.MEET, title=words.meet, text=words.meet_text, keys=(self._stop,))

    def practice(self, round_number: int) -> Screen:
        """Return the screen before a round of practice."""
        words = self._words
        text = words.practice_again if round_number else words.practice_text
        return Screen(kind=ScreenKind.PRACTICE, title=words.practice, text=text, keys=self._next)

    def trial(self, typed: str, progress: str, *, untouched: int | None = None) -> Screen:
        """Return the screen of a trial; `untouched` is the tissue that must be touched before the answer is taken."""
        words = self._words
        keys = [(key, words.tissue.format(number=key)) for key in TISSUE_KEYS if key not in typed]
        if typed:
            keys.append((BACKSPACE, words.undo))
        if len(typed) == len(TISSUE_KEYS):
            keys.append((ENTER, words.confirm))
        return Screen(
            kind=ScreenKind.TRIAL,
            title=words.trial,
            text=words.trial_text,
            keys=(*keys, self._stop),
            typed=typed,
            remark="" if untouched is None else words.untouched.format(number=untouched),
            progress=progress,
        )

    def moment(self, *, halted: bool) -> Screen:
        """Return the screen while what was performed comes to its end."""
        words = self._words
        text = words.halt_text if halted else words.moment_text
        return Screen(kind=ScreenKind.MOMENT, title=words.moment, text=text)

    def stimuli(self, progress: str) -> Screen:
        """Return the screen while two forces are presented."""
        words = self._words
        return Screen(
            kind=ScreenKind.STIMULI, title=words.stimuli, text=words.stimuli_text, keys=(self._stop,),
            progress=progress,
        )  # fmt: skip

    def same_or_different(self, progress: str) -> Screen:
        """Return the question of the method of limits."""
        words = self._words
        return Screen(
            kind=ScreenKind.QUESTION,
            title=words.ascending,
            text=words.ascending_text,
            keys=((SAME, words.same), (DIFFERENT, words.different), self._end),
            progress=progress,
        )

    def which_stronger(self, progress: str) -> Screen:
        """Return the question of the forced choice."""
        words = self._words
        return Screen(
            kind=ScreenKind.QUESTION,
            title=words.choice,
            text=words.choice_text,
            keys=(("1", words.first), ("2", words.second), self._end),
            progress=progress,
        )

    def feedback(self, answered: str, right: str, now_us: int) -> Screen:
        """Return the feedback of a practice trial."""
        words = self._words
        return Screen(
            kind=ScreenKind.FEEDBACK,
            title=words.right if answered == right else words.wrong,
            text=words.feedback.format(order=" ".join(right), answer=" ".join(answered)),
            keys=self._next,
            not_before_us=now_us + READ_US,
        )

    def repeat(self, why: str, now_us: int) -> Screen:
        """Return the screen after a trial that does not count; `why` is one of the texts for that."""
        words = self._words
        return Screen(
            kind=ScreenKind.REPEAT,
            title=words.repeat,
            text=words.repeat_text.format(why=why),
            keys=self._next,
            not_before_us=now_us + READ_US,
        )

    def rating(self, progress: str) -> Screen:
        """Return the question for the quality of experience."""
        words = self._words
        return Screen(
            kind=ScreenKind.RATING,
            title=words.rating,
            text=words.rating_text.format(low=words.rating_low, high=words.rating_high),
            keys=(*((key, "") for key in RATING_KEYS), self._end),
            progress=progress,
        )

    def pause(self, not_before_us: int, progress: str) -> Screen:
        """Return the screen of a break."""
        words = self._words
        return Screen(
            kind=ScreenKind.BREAK,
            title=words.pause,
            text=words.pause_text,
            keys=self._next,
            progress=progress,
            not_before_us=not_before_us,
        )

    def done(self) -> Screen:
        """Return the last screen."""
        return Screen(kind=ScreenKind.DONE, title=self._words.done, text=self._words.done_text)

    def stopped(self) -> Screen:
        """Return the screen of a session that cannot go on now; why is for the experimenter."""
        words = self._words
        return Screen(kind=ScreenKind.STOPPED, title=words.interrupted, text=words.interrupted_text)
