"""What a participant reads: one TOML file, of which ``texts.toml`` is the English one that is shipped."""

from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, Final, TypeAlias

from pydantic import BaseModel, Field, ValidationInfo, model_validator

from hapticnet.checks import meant
from hapticnet.documents import NOT_BLANK, STRICT, parse_document, read_document, text_of
from hapticnet.errors import SettingsError
from hapticnet.files import user_path

SHIPPED: Final = "the texts that are shipped"  # what is validated without a comparison with itself
Table: TypeAlias = dict[str, Annotated[str, NOT_BLANK, Field(max_length=4000)]]


class Texts(BaseModel):
    """Everything that a participant reads. Each table has the keys of ``texts.toml``, which says what they are for."""

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
        """What a participant agrees to: all paragraphs of the consent."""
        return "\n\n".join(self.consent[topic] for topic in english().consent)

    @property
    def levels(self) -> dict[str, dict[str, str]]:
        """What values of a column of the data meant to the participant, by column."""
        return {"rating": {"1": self.screens["rating_low"], "7": self.screens["rating_high"]}}

    def for_page(self) -> dict[str, str]:
        """Return what the participant's page needs besides its tasks, by key."""
        shared = "rating_low", "rating_high", "answer", "tissue", "undo", "confirm", "end"
        return {"language": self.language, **self.page, **self.keys, **{key: self.screens[key] for key in shared}}

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> "Texts":
        """Refuse texts that have other keys, or other words in braces, than the English ones."""
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
    """Return the file of the texts that are shipped."""
    return (files("hapticnet.study") / "texts.toml").read_text(encoding="utf-8")


@cache
def english() -> Texts:
    """Return the texts that are shipped."""
    return parse_document(shipped(), "texts.toml", Texts, context=SHIPPED)


def find_texts(spec: object, folder: Path) -> Any:
    """Return the texts that a plan names: a file beside it, or the texts themselves, as a stored plan has them.

    Raise SettingsError if a text is missing, empty, unknown, or without the words in braces.
    """
    if not isinstance(spec, str):
        return spec
    if not spec.endswith(".toml"):
        raise SettingsError(f"texts {spec!r} is no .toml file; write one with 'hapticnet experiment texts'")
    path = folder / user_path(spec)
    return parse_document(read_document(path), str(path), Texts)
