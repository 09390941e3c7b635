"""The law of a participant, as options give it."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from hapticnet.documents import parse_document, read_document
from hapticnet.errors import SettingsError
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw


class LawFile(BaseModel):
    """A participant's law in a TOML file, as ``hapticnet experiment limits`` writes it; other keys are not read."""

    model_config = ConfigDict(extra="ignore", strict=True)

    weber_fraction: Annotated[float, Field(ge=0.0, le=1.0)]
    floor_n: Annotated[float, Field(ge=0.0)]


def law_given(weber: float, floor: float, multiplier: float, law: Path | None) -> WeberLaw:
    """Return the law of a participant's file, or of the numbers given.

    Raises
    ------
    FileError
        If the file cannot be read.
    SettingsError
        If a number cannot be used, or the law is given in both ways.
    """
    if law is None:
        return WeberLaw(weber_fraction=weber, floor_n=floor, multiplier=multiplier)
    if (weber, floor) != (PAPER_WEBER_FRACTION, PAPER_FLOOR_N):
        raise SettingsError(f"--law {law} gives the law; leave out --weber and --floor")
    measured = parse_document(read_document(law), str(law), LawFile)
    return WeberLaw(weber_fraction=measured.weber_fraction, floor_n=measured.floor_n, multiplier=multiplier)
