"""The four conditions of the paper, and what it reports of them."""

from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """One way to treat the force on its way to the finger.

    Attributes
    ----------
    name
        As the paper calls it.
    codec, multiplier
        The codec, and its threshold in JNDs.
    paper_correct
        Fraction of trials in which the paper's subjects put the tissues in the right order of stiffness.
    paper_byte_reduction
        By how much the paper's bytes per penetration fell; None where it gives no figure.
    """

    name: str
    codec: str
    multiplier: float
    paper_correct: float
    paper_byte_reduction: float | None = None

    @property
    def slug(self) -> str:
        """The name as part of a file name."""
        return self.name.lower().replace(" ", "-")


CONDITIONS: Final = (
    Condition(name="none", codec="raw", multiplier=1.0, paper_correct=0.775, paper_byte_reduction=0.0),
    Condition(name="1 JND", codec="deadband", multiplier=1.0, paper_correct=0.80, paper_byte_reduction=0.617),
    Condition(name="2 JND", codec="deadband", multiplier=2.0, paper_correct=0.675),
    Condition(name="4 JND", codec="deadband", multiplier=4.0, paper_correct=0.5375),
)
"""Source: "Cutaneous haptic deadband compression". "none" transmits every sample."""


def conditions_with(codec: str) -> tuple[Condition, ...]:
    """Return the same conditions with another codec, as written for ``--codec``, in place of the deadband."""
    return tuple(
        replace(condition, codec=codec) if condition.codec == "deadband" else condition for condition in CONDITIONS
    )
