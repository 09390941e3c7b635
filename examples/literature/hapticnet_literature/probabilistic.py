"""The deadband for networks that lose packets: it repeats updates that the receiver has probably missed.

After Kammerl, Brandi, Schweiger, Steinbach, "Error-resilient perceptual haptic data communication based on
probabilistic receiver state estimation", EuroHaptics 2012, and "Error-resilient perceptual coding for networked haptic
interaction", in which the sender keeps a tree of the cases (received, not received) and their probabilities. If the
receiver holds, the tree folds into a list: whatever else was lost, it holds the newest update that arrived.
"""

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.deadband import ValueScheme
from hapticnet.codec.steps import ZERO_ORDER_HOLD, MakeTable, Steps, Table
from hapticnet.codec.values import check_step, law_numbers, rounded, value_bytes
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import distance, put, row

MOST_STATES: Final = 16
"""How many updates are remembered. A receiver that holds an older one counts as deviating."""


class ProbabilisticRule(NamedTuple):
    """The numbers of the rule, and the newest updates.

    Attributes
    ----------
    held, older
        By age of an update: the probability that it, or an older one, is held.
    references, thresholds
        The newest updates, in tables that are written in a circle.
    """

    weber: float
    floor: float
    step: float
    limit: float
    held: tuple[float, ...]
    older: tuple[float, ...]
    references: Table
    thresholds: list[float]


def start(rule: Any, axes: int) -> int:
    """Return the number of updates written: 0."""
    return 0


def is_silent(rule: ProbabilisticRule, written: int, t_us: int, x: Vector) -> bool:
    """Tell whether the receiver is probably within the threshold."""
    references, thresholds = rule.references, rule.thresholds
    held, older, limit = rule.held, rule.older, rule.limit
    doubt = 0.0
    for age in range(min(written, MOST_STATES)):
        place = (written - 1 - age) % MOST_STATES
        if not distance(x, row(references, place, x)) <= thresholds[place]:
            doubt += held[age]
        if doubt + older[age] <= limit:
            return True
        if doubt > limit:
            return False
    return False


def send(rule: ProbabilisticRule, written: int, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], int]:
    """Send the stimulus and remember it."""
    form, reference, threshold = rounded(rule, x)
    put(rule.references, written % MOST_STATES, reference)
    rule.thresholds[written % MOST_STATES] = threshold
    return (form, reference), written + 1


def refreshed(written: int) -> int:
    """Forget what the receiver may be holding."""
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Probabilistic(ValueScheme):
    """Transmit what leaves the dead zone, and repeat it while the receiver may hold an older update.

    With p = `loss_probability` and updates r₁ (newest), r₂, … the receiver holds rⱼ with probability
    ``P(rⱼ) = (1 - p)·pʲ⁻¹``: the newest that arrived, losses being independent. Rule: send x when
    ``|x - r₁| > threshold(|r₁|)``, as the deadband does, or when
    ``Σ P(rⱼ) over all j with |x - rⱼ| > threshold(|rⱼ|)`` exceeds `deviation_limit`, where a receiver that holds
    something older than the 16 newest updates, or nothing yet, counts as deviating. All comparisons are strict.

    A repetition carries the *present* stimulus and is sent at the next sample. While the force is outside the dead
    zones of older updates, each update is sent ⌈log(deviation_limit) / log(p)⌉ times; with a limit of p or more nothing
    is repeated. Repetition needs no answer, so it repairs sooner than a round trip. The session repairs bursts of
    losses, which also take the repetitions. Without loss the held stimulus is within the threshold at every sample.
    Payload: the deadband's.

    Attributes
    ----------
    loss_probability
        Assumed probability of losing a packet, 0 to 0.9; 0: the deadband. The default is an assumption.
    deviation_limit
        Probability of a receiver that deviates by more than the threshold, 0.001 to 1, above which it sends again.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "probabilistic"
    receiver_has_tables: ClassVar[bool] = True
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        payload_bytes=value_bytes,
        **ZERO_ORDER_HOLD,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    loss_probability: float = 0.1
    deviation_limit: float = 0.05
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("loss_probability", self.loss_probability, 0.0, 0.9)
        check_parameter("deviation_limit", self.deviation_limit, 1e-3, 1.0)
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> ProbabilisticRule:
        """Return law, step of counts, limit, probabilities and room for updates."""
        loss = self.loss_probability
        held, older = [1.0 - loss], [loss]
        for _ in range(1, MOST_STATES):
            held.append(held[-1] * loss)
            older.append(older[-1] * loss)
        held[0] = math.inf  # what leaves the dead zone of the newest update is sent whatever the limit
        return ProbabilisticRule(
            *law_numbers(self.law),
            step=self.step_n,
            limit=self.deviation_limit,
            held=tuple(held),
            older=tuple(older),
            references=table(MOST_STATES, axes),
            thresholds=table(1, MOST_STATES)[0],
        )
