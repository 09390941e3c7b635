"""What a participant reads: one file for each language, of which those in ``languages`` are shipped."""

from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, Final, TypeAlias

from pydantic import BaseModel, Field, ValidationInfo, model_validator

from hapticnet.documents import NOT_BLANK, STRICT, parse_document, read_document, text_of
from hapticnet.errors import SettingsError
from hapticnet.files import user_path

LANGUAGES: Final = files("hapticnet.study") / "languages"
SHIPPED: Final = tuple(sorted(entry.name.removesuffix(".toml") for entry in LANGUAGES.iterdir()))
"""Languages whose texts need no file."""

ENGLISH: Final = "en"

Text: TypeAlias = Annotated[str, NOT_BLANK, Field(max_length=4000)]


class ConsentTexts(BaseModel):
    """What a participant agrees to, by topic: a text without one of them is refused."""

    model_config = STRICT

    purpose: Text
    task: Text
    duration: Text
    risk: Text
    stopping: Text
    data: Text
    contact: Text

    @property
    def whole(self) -> str:
        """All paragraphs."""
        return "\n\n".join(self.model_dump().values())


class InstructionTexts(BaseModel):
    """The first screen of each task."""

    model_config = STRICT

    order: Text
    ascending: Text
    choice: Text


class WhyTexts(BaseModel):
    """Why something comes again; the reason in the table may tell forces, these do not."""

    model_config = STRICT

    stopped: Text
    late: Text
    unmet: Text
    undelivered: Text
    untouched: Text
    lifted: Text
    fault: Text


class ScreenTexts(BaseModel):
    """Titles, texts and buttons of the screens."""

    model_config = STRICT

    go_on: Text
    end: Text
    stop: Text
    instructions: Text
    again: Text
    consent: Text
    agree: Text
    disagree: Text
    about: Text
    prefer_not: Text
    meet: Text
    meet_text: Text
    practice: Text
    practice_text: Text
    practice_again: Text
    practising: Text
    trial: Text
    trial_text: Text
    trials: Text
    tissue: Text
    undo: Text
    confirm: Text
    answer: Text
    untouched: Text
    moment: Text
    moment_text: Text
    halt_text: Text
    stimuli: Text
    stimuli_text: Text
    series: Text
    ascending: Text
    ascending_text: Text
    same: Text
    different: Text
    choice: Text
    choice_text: Text
    first: Text
    second: Text
    right: Text
    wrong: Text
    feedback: Text
    repeat: Text
    repeat_text: Text
    rating: Text
    rating_text: Text
    rating_low: Text
    rating_high: Text
    pause: Text
    pause_text: Text
    wait: Text
    done: Text
    done_text: Text
    interrupted: Text
    interrupted_text: Text


class KeyTexts(BaseModel):
    """Names of keys that have no letter."""

    model_config = STRICT

    enter: Text
    escape: Text
    backspace: Text


class PageTexts(BaseModel):
    """What stands around the screens on the participant's page; ``static/texts.js`` shows it."""

    model_config = STRICT

    connecting: Text
    connected: Text
    reconnecting: Text
    closed: Text
    finished: Text
    lost: Text
    lost_text: Text
    gone_text: Text
    refused: Text
    retry: Text
    not_possible: Text
    noise: Text
    noise_level: Text
    noise_help: Text
    colours: Text
    ending: Text
    ending_text: Text
    stay: Text
    go_on_in: Text
    softest: Text
    hardest: Text
    front: Text
    middle: Text
    back: Text
    rating: Text
    needle: Text
    depth: Text
    breached: Text
    not_yet: Text
    free: Text
    yours: Text
    waiting: Text
    withdrawing: Text
    elsewhere: Text
    hint: Text
    hint_elsewhere: Text
    take: Text
    let_go: Text


class Texts(BaseModel):
    """Everything that a participant reads."""

    model_config = STRICT

    language: Annotated[
        str, text_of("[a-zA-Z]{2,3}(-[a-zA-Z0-9]{1,8})*", "the tag of a language, such as 'en' or 'pt-BR'")
    ]
    consent: ConsentTexts
    instructions: InstructionTexts
    why: WhyTexts
    screens: ScreenTexts
    keys: KeyTexts
    page: PageTexts

    @property
    def levels(self) -> dict[str, dict[str, str]]:
        """What values of a column of the data meant to the participant, by column."""
        return {"rating": {"1": self.screens.rating_low, "7": self.screens.rating_high}}

    def for_page(self) -> dict[str, str]:
        """Return what the participant's page needs besides its tasks, by key."""
        shared = {"rating_low", "rating_high", "answer", "tissue", "undo", "confirm", "end"}
        return {
            "language": self.language,
            **self.page.model_dump(),
            **self.keys.model_dump(),
            **self.screens.model_dump(include=shared),
        }

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> "Texts":
        """Refuse texts that have other words in braces than the English ones."""
        if info.context != ENGLISH:
            right = english().model_dump()
            for table, texts in self.model_dump(exclude={"language"}).items():
                for key, text in texts.items():
                    expected = _filled_in(right[table][key])
                    if _filled_in(text) != expected:
                        names = (
                            " and ".join(f"{{{name}}}" for name in sorted(map(str, expected))) or "no words in braces"
                        )
                        raise ValueError(f"{table}.{key} must have {names}, but it is {text!r}")
        return self


def _filled_in(text: str) -> set[str | None]:
    try:
        return {name for _, name, _, _ in Formatter().parse(text) if name is not None}
    except ValueError:  # a single brace
        return {None}


@cache
def english() -> Texts:
    """Return the texts that are shipped."""
    return parse_document(shipped(ENGLISH), "en.toml", Texts, context=ENGLISH)


def shipped(language: str) -> str:
    """Return the file of a language that is shipped; raise SettingsError if there is none."""
    if language not in SHIPPED:
        raise SettingsError(f"no texts are shipped in {language!r}; there are {', '.join(SHIPPED)}")
    return (LANGUAGES / f"{language}.toml").read_text(encoding="utf-8")


def find_texts(spec: object, folder: Path) -> Any:
    """Return the texts that a plan names: a language that is shipped, or a file beside the plan.

    Parameters
    ----------
    spec
        What the plan says; the texts themselves, as a plan that was stored has them, are returned as they are.
    folder
        Folder of the plan.

    Raises
    ------
    FileError
        If the file cannot be read.
    SettingsError
        If a text is missing, empty, unknown, or without the words in braces.
    """
    if not isinstance(spec, str):
        return spec
    if spec.endswith(".toml"):
        path = folder / user_path(spec)
        return parse_document(read_document(path), str(path), Texts)
    return parse_document(shipped(spec), f"{spec}.toml", Texts, context=spec)
