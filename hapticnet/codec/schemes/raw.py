"""Transmit every sample: the uncompressed condition to which all other codecs are compared."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

from hapticnet.codec.steps import ZERO_ORDER_HOLD, MakeTable, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import (
    COUNT_BYTES,
    SINGLE_BYTES,
    ValueForm,
    ValueRule,
    are_countable,
    check_step,
    counted,
    value_bytes,
)
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import single


def start(rule: Any, axes: int) -> None:
    """Return None: the sender needs no state."""


def is_silent(rule: ValueRule, sender: None, t_us: int, x: Vector) -> bool:
    """Return False: every sample is sent."""
    return False


def send(rule: ValueRule, sender: None, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], None]:
    """Return counts if all components are in range, else float32."""
    if rule.step > 0.0 and are_countable(x, rule.step):
        return (COUNT_BYTES, counted(x, rule.step)), sender
    return (SINGLE_BYTES, single(x)), sender


def refreshed(sender: None) -> None:
    """Return the state: the next stimulus is always sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Raw(Scheme):
    """Transmit every stimulus; perception does not matter.

    Rule: always send. Payload: float32 an axis. The paper's condition "none".

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N] if all components are within ±32 767 steps, which moves each by at most
        half a step; 0: always float32.
    """

    name: ClassVar[str] = "raw"
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        payload_bytes=value_bytes,
        **ZERO_ORDER_HOLD,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self: Any) -> None:
        check_step(self.step_n)

    def rule(self: Any, axes: int, table: MakeTable) -> ValueRule:  # noqa: ARG002
        """Return the step of counts; the law does not matter."""
        return ValueRule(0.0, 0.0, self.step_n)

    def form(self: Any, axes: int) -> ValueForm:
        """Return the form of its messages."""
        return ValueForm(axes, step_n=self.step_n, wide=False)
