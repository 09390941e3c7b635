"""Everything random of a session, drawn before it begins, from one seed, and stored."""

import json
import re
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, Final, Self

import numpy as np

from hapticnet.checks import check_integer
from hapticnet.errors import FileError, SettingsError
from hapticnet.study.plan import Plan

LARGEST_SEED: Final = 2**31


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule(ABC):
    """What is common to the schedules of both parts of a study: whose it is, and the digest of its plan."""

    participant: str
    session: int
    seed: int
    plan: str

    @abstractmethod
    def lines(self, plan: Plan) -> list[str]:
        """Return the schedule for a person."""

    @classmethod
    @abstractmethod
    def _restored(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Return the values of the attributes from what JSON has made of them."""

    def to_json(self) -> str:
        """Return the schedule as text."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, source: str) -> Self:
        """Return the schedule in a text; raise FileError if it is none."""
        try:
            return cls(**cls._restored(json.loads(text)))
        except (ValueError, TypeError, KeyError) as error:
            raise FileError(f"{source}: not a schedule: {error}") from error


def participant_number(participant: str) -> int:
    """Return the number of a participant such as "03"; raise SettingsError if it is none. Names are not stored."""
    if not re.fullmatch(r"[0-9]{1,6}", participant):
        raise SettingsError(f"participant {participant[:40]!r}: expected a number such as 03; names are not stored")
    return int(participant)


def generator(participant: str, session: int, seed: int, part: int) -> np.random.Generator:
    """Return the source of everything random in a part of a session.

    Raises
    ------
    SettingsError
        If participant or session is not a number, or the seed is negative.
    """
    number = participant_number(participant)
    check_integer("session", session, 1, 1000)
    check_integer("seed", seed, 0, LARGEST_SEED)
    return np.random.default_rng([seed, number, session, part])
