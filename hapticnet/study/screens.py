"""What a participant sees, and which keys answer it. Terminal, page and simulated observers show the same screens."""

import enum
import hashlib
from dataclasses import dataclass
from typing import Final

ENTER: Final = "enter"
ESCAPE: Final = "escape"
BACKSPACE: Final = "backspace"
TISSUE_KEYS: Final = ("1", "2", "3")
SAME: Final = "s"
DIFFERENT: Final = "d"
YES: Final = "y"
NO: Final = "n"
RATING_KEYS: Final = tuple("1234567")


class ScreenKind(enum.StrEnum):
    """What a screen is for."""

    INSTRUCTIONS = "instructions"
    CONSENT = "consent"
    MEET = "meet"
    PRACTICE = "practice"
    TRIAL = "trial"
    STIMULI = "stimuli"
    QUESTION = "question"
    FEEDBACK = "feedback"
    REPEAT = "repeat"
    RATING = "rating"
    BREAK = "break"
    STOPPED = "stopped"
    DONE = "done"


class Why(enum.StrEnum):
    """Why a trial comes again, in words for the participant; the reason in the table may tell forces, these do not."""

    STOPPED = "it was stopped"
    LATE = "the time was over before you answered"
    UNMET = "the platform did not find your finger"
    UNDELIVERED = "the forces did not reach your finger in full"
    LIFTED = "your finger was lifted"
    FAULT = "there was a technical fault"


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
    progress: str = ""
    not_before_us: int | None = None


END: Final = (ESCAPE, "end the session")
NEXT: Final = ((ENTER, "go on"), END)
STOP: Final = (ESCAPE, "stop: the force goes to zero at once")

ORDER_INSTRUCTIONS: Final = (
    "You hold a needle above three tissues, called 1, 2 and 3 from front to back. They differ in stiffness. Push the"
    " needle through them, one after the other, slowly and as often as you like; you feel each at your fingertip. Then"
    " type the tissues from the softest to the hardest, for instance 2 1 3, and confirm with Enter. Until then you may"
    " change your answer with Backspace. Take your time. You may stop at any moment with Escape or by lifting your"
    " finger; the force is then zero at once, and the trial comes again later. Escape between two trials ends the"
    " session."
)
ASCENDING_INSTRUCTIONS: Final = (
    "You feel two forces at your fingertip, one after the other. Then say whether they felt the same or different. Say"
    " different only if you felt a difference. There are series in which nothing changes. You may stop at any moment"
    " with Escape or by lifting your finger."
)
CHOICE_INSTRUCTIONS: Final = (
    "You feel two forces at your fingertip, one after the other. Then say which was stronger, the first or the second."
    " If you are not sure, guess. You may stop at any moment with Escape or by lifting your finger."
)


def hash_of(text: str) -> str:
    """Return the SHA-256 of a text that was agreed to."""
    return hashlib.sha256(text.encode()).hexdigest()


def instructions(text: str, *, again: bool) -> Screen:
    """Return the first screen of a session, or of one that goes on."""
    title = "The session goes on" if again else "Instructions"
    return Screen(kind=ScreenKind.INSTRUCTIONS, title=title, text=text, keys=NEXT)


def consent(text: str) -> Screen:
    """Return the screen that asks for consent."""
    return Screen(kind=ScreenKind.CONSENT, title="Consent", text=text, keys=((YES, "I agree"), (NO, "I do not agree")))


def meeting() -> Screen:
    """Return the screen while the platform meets the finger."""
    return Screen(
        kind=ScreenKind.MEET,
        title="Hold your finger still",
        text="The platform finds your finger and presses it lightly for a second.",
        keys=(STOP,),
    )


def practice(round_number: int) -> Screen:
    """Return the screen before a round of practice."""
    text = "Some trials for practice follow. After each you see the right order."
    if round_number:
        text = "Let us practise once more. " + text
    return Screen(kind=ScreenKind.PRACTICE, title="Practice", text=text, keys=NEXT)


def trial(typed: str, progress: str) -> Screen:
    """Return the screen of a trial."""
    keys = [(key, f"tissue {key}") for key in TISSUE_KEYS if key not in typed]
    if typed:
        keys.append((BACKSPACE, "undo"))
    if len(typed) == len(TISSUE_KEYS):
        keys.append((ENTER, "confirm"))
    return Screen(
        kind=ScreenKind.TRIAL,
        title="Feel the three tissues",
        text="Put them in order, from the softest to the hardest.",
        keys=(*keys, STOP),
        typed=typed,
        progress=progress,
    )


def stimuli(progress: str) -> Screen:
    """Return the screen while two forces are presented."""
    return Screen(
        kind=ScreenKind.STIMULI, title="Two forces", text="Feel the first and the second force.", keys=(STOP,),
        progress=progress,
    )  # fmt: skip


def same_or_different(progress: str) -> Screen:
    """Return the question of the method of limits."""
    return Screen(
        kind=ScreenKind.QUESTION,
        title="Same or different?",
        text="Did the two forces feel the same or different?",
        keys=((SAME, "same"), (DIFFERENT, "different"), END),
        progress=progress,
    )


def which_stronger(progress: str) -> Screen:
    """Return the question of the forced choice."""
    return Screen(
        kind=ScreenKind.QUESTION,
        title="Which was stronger?",
        text="Which force was stronger? If you are not sure, guess.",
        keys=(("1", "the first"), ("2", "the second"), END),
        progress=progress,
    )


def feedback(answered: str, right: str) -> Screen:
    """Return the feedback of a practice trial."""
    verdict = "Right" if answered == right else "Not quite"
    text = f"{verdict}: from the softest to the hardest, the order is {' '.join(right)}. You said {' '.join(answered)}."
    return Screen(kind=ScreenKind.FEEDBACK, title=verdict, text=text, keys=NEXT)


def repeat(why: Why) -> Screen:
    """Return the screen after a trial that does not count."""
    return Screen(
        kind=ScreenKind.REPEAT,
        title="This one comes again",
        text=f"It does not count: {why}. Please put your finger back, and move slowly.",
        keys=NEXT,
    )


def rating(progress: str) -> Screen:
    """Return the question for the quality of experience."""
    return Screen(
        kind=ScreenKind.RATING,
        title="How did the tissues of this block feel?",
        text="From 1, very artificial or disturbed, to 7, like real tissue.",
        keys=(*((key, "") for key in RATING_KEYS), END),
        progress=progress,
    )


def pause(not_before_us: int, progress: str) -> Screen:
    """Return the screen of a break."""
    return Screen(
        kind=ScreenKind.BREAK,
        title="Break",
        text="Take your finger out and rest. Put it back before you go on.",
        keys=NEXT,
        progress=progress,
        not_before_us=not_before_us,
    )


def done() -> Screen:
    """Return the last screen."""
    return Screen(kind=ScreenKind.DONE, title="Thank you", text="The session is over. You may take your finger out.")


def stopped() -> Screen:
    """Return the screen of a session that cannot go on now; why is for the experimenter."""
    return Screen(
        kind=ScreenKind.STOPPED,
        title="The session is interrupted",
        text="Please tell the experimenter. Your answers are safe.",
    )
