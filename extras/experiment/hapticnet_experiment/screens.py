"""The participant's texts, from a TOML file, and screens with their keys."""

import enum
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from string import Formatter
from typing import Annotated, Any, Final, TypeAlias

from pydantic import BaseModel, Field, ValidationInfo, model_validator

from hapticnet.checks import meant
from hapticnet.documents import STRICT, parse_document, text_of

ENTER: Final = "enter"
ESCAPE: Final = "escape"
BACKSPACE: Final = "backspace"
TISSUE_KEYS: Final = ("1", "2", "3")
SAME: Final = "s"
DIFFERENT: Final = "d"
YES: Final = "y"
NO: Final = "n"
RATING_KEYS: Final = tuple("1234567")
READ_US: Final = 1_000_000  # feedback stays this long [µs]: an early Enter was meant for the previous screen
Keys: TypeAlias = tuple[tuple[str, str], ...]  # active keys, with their effects
KEYS: Final = {  # the key of each action, by the name of its text
    "go_on": ENTER, "confirm": ENTER, "undo": BACKSPACE, "end": ESCAPE, "stop": ESCAPE, "agree": YES, "disagree": NO,
    "same": SAME, "different": DIFFERENT, "first": "1", "second": "2",
}  # fmt: skip

SHIPPED: Final = "the texts that are shipped"  # set while validating without a comparison with itself
NOT_BLANK: Final = text_of(r"(?s:.*\S.*)", "text that is not blank")
Table: TypeAlias = dict[str, Annotated[str, NOT_BLANK, Field(max_length=4000)]]


class Texts(BaseModel):
    """All texts for a participant. Each table has the keys of ``texts.toml``, which explains them."""

    model_config = STRICT

    language: Annotated[
        str, text_of("[a-zA-Z]{2,3}(-[a-zA-Z0-9]{1,8})*", "the tag of a language, such as 'en' or 'pt-BR'")
    ]
    consent: Table
    instructions: Table
    why: Table
    screens: Table
    keys: Table
    page: Table

    @property
    def agreement(self) -> str:
        """The text a participant agrees to: all paragraphs of the consent."""
        return "\n\n".join(self.consent[topic] for topic in english().consent)

    @property
    def levels(self) -> dict[str, dict[str, str]]:
        """The participant's wording of a column's values, by column."""
        return {"rating": {"1": self.screens["rating_low"], "7": self.screens["rating_high"]}}

    def for_page(self) -> dict[str, str]:
        """Return the participant's page's other texts, by key."""
        shared = "rating_low", "rating_high", "answer", "tissue", "undo", "confirm", "end"
        return {"language": self.language, **self.page, **self.keys, **{key: self.screens[key] for key in shared}}

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> "Texts":
        """Refuse texts whose keys, or words in braces, differ from the English ones."""
        if info.context == SHIPPED:
            return self
        given = self.model_dump(exclude={"language"})
        for table, expected in english().model_dump(exclude={"language"}).items():
            for key in given[table]:
                if key not in expected:
                    raise ValueError(f"unknown key {f'{table}.{key}'!r}{meant(key, expected)}")
            for key, text in expected.items():
                if key not in given[table]:
                    raise ValueError(f"{table}.{key} is missing")
                words = _filled_in(text)
                if _filled_in(given[table][key]) != words:
                    names = " and ".join(f"{{{name}}}" for name in sorted(map(str, words))) or "no words in braces"
                    raise ValueError(f"{table}.{key} must have {names}, but it is {given[table][key]!r}")
        return self


def _filled_in(text: str) -> set[str | None]:
    try:
        return {name for _, name, _, _ in Formatter().parse(text) if name is not None}
    except ValueError:  # a single brace
        return {None}


def shipped() -> str:
    """Return the file of the default texts."""
    return (files("hapticnet_experiment") / "texts.toml").read_text(encoding="utf-8")


@cache
def english() -> Texts:
    """Return the default texts."""
    return parse_document(shipped(), "texts.toml", Texts, context=SHIPPED)


class ScreenKind(enum.StrEnum):
    """The purpose of a screen."""

    INSTRUCTIONS = "instructions"
    CONSENT = "consent"
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
    """One screen. It never shows the condition."""

    kind: ScreenKind
    title: str
    text: str
    keys: Keys = ()
    typed: str = ""  # of an answer
    remark: str = ""  # why the last key was invalid
    progress: str = ""  # progress of the session; empty where irrelevant
    not_before_us: int | None = None  # time [µs] before which `ENTER` does nothing


def hash_of(text: str) -> str:
    """Return the SHA-256 of a text that was agreed to."""
    return hashlib.sha256(text.encode()).hexdigest()


def question_of(screen: Screen) -> Screen:
    """Return a screen's question, regardless of earlier answers."""
    return replace(screen, keys=(), typed="", remark="")


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
        """Return the screen with the title `name` and, unless another is given, its text.

        Its keys are those of `choices`, each with its effect, and then those of `actions`.
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
        """Return the screen of a trial; `untouched` is the tissue that must be touched before an answer counts."""
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
