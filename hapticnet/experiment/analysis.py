"""The paper's conditions, and the costs and errors of a run: bytes per penetration, and errors of the held force."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.measure.metrics import FeltReport, error_report
from hapticnet.node.recording import axis_columns
from hapticnet.parts import PartsLaw
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES
from hapticnet.samples import MAX_AXES
from hapticnet.scene.settings import Tissue

Columns = Mapping[str, FloatArray]  # a recording: columns by name, shape (n,) each; see `node.recording`


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """One way to treat the force on its way to the finger, named as in the paper."""

    name: str
    codec: str
    multiplier: float  # threshold in JNDs
    paper_correct: float  # share of trials in which the paper's subjects ordered the tissues by stiffness
    paper_byte_reduction: float | None = None  # of the paper's bytes per penetration; None: it gives no figure

    @property
    def slug(self) -> str:
        """The name as part of a file name."""
        return self.name.lower().replace(" ", "-")


CONDITIONS: Final = (  # source: "Cutaneous haptic deadband compression". "none" transmits every sample
    Condition(name="none", codec="raw", multiplier=1.0, paper_correct=0.775, paper_byte_reduction=0.0),
    Condition(name="1 JND", codec="deadband", multiplier=1.0, paper_correct=0.80, paper_byte_reduction=0.617),
    Condition(name="2 JND", codec="deadband", multiplier=2.0, paper_correct=0.675),
    Condition(name="4 JND", codec="deadband", multiplier=4.0, paper_correct=0.5375),
)


def conditions_with(codec: str) -> tuple[Condition, ...]:
    """Return the same conditions with another codec, as written for ``--codec``, instead of the deadband."""
    return tuple(
        replace(condition, codec=codec) if condition.codec == "deadband" else condition for condition in CONDITIONS
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class BytesPerPenetration:
    """Feedback bytes from touching a tissue to breaching it, including keepalives and UDP and IPv4 headers."""

    each: tuple[int, ...]  # bytes of each penetration, in order of time
    depths_m: tuple[float, ...]  # positions of the tip at the breaches [m], in the same order, on the first axis

    @property
    def mean(self) -> float:
        """Mean [B] over all penetrations; 0 without any."""
        return float(np.mean(self.each)) if self.each else 0.0

    @property
    def deviation(self) -> float:
        """Standard deviation [B] over all penetrations, which mixes the tissues; 0 with fewer than two."""
        return float(np.std(self.each, ddof=1)) if len(self.each) > 1 else 0.0

    def by_tissue(self, tissues: Sequence[Tissue]) -> list[list[int]]:
        """Return the bytes of the penetrations of each tissue: the deepest whose surface at rest is before the tip.

        This holds for tissues that are breached before the next one is touched, as in the paper's scene.
        """
        surfaces_m = [tissue.rest_position_m for tissue in tissues]
        found: list[list[int]] = [[] for _ in tissues]
        for spent, depth_m in zip(self.each, self.depths_m, strict=True):
            found[max(bisect_right(surfaces_m, depth_m) - 1, 0)].append(spent)
        return found


def bytes_per_penetration(slave: Columns, *, contacts: bool = False) -> BytesPerPenetration:
    """Return the cost of every penetration in a slave's recording, or of every contact; see `spent_until`."""
    datagrams = slave["datagram_bytes"]
    wire = np.where(datagrams > 0, datagrams + UDP_IPV4_HEADER_BYTES, 0.0)
    force = vectors(slave, "force", "n")
    # On one axis, friction on a withdrawing shaft gives a negative force, which ends a contact.
    touching = np.any(force > 0.0 if force.shape[1] == 1 else force != 0.0, axis=1)
    if contacts:
        breaches = np.flatnonzero(touching & ~np.append(touching[1:], [False]))
    else:
        breaches = np.flatnonzero(np.diff(slave["breaches"], prepend=0.0) > 0)
    each = spent_until(wire, touching, breaches)
    return BytesPerPenetration(each=tuple(each), depths_m=tuple(vectors(slave, "position", "m")[breaches, 0].tolist()))


def spent_until(
    wire: FloatArray, touching: npt.NDArray[np.bool_], breaches: npt.NDArray[np.signedinteger[Any]]
) -> list[int]:
    """Return the cost of each penetration, such as bytes: `wire` at each sample, `breaches` counted so far.

    It starts after the last sample without contact or after the previous breach, and ends with the breach: data sent
    while nothing is touched belongs to no penetration.
    """
    spent = np.concatenate([[0.0], np.cumsum(wire)])
    free = np.flatnonzero(~touching)
    each, begin = [], 0
    for end in breaches.tolist():
        before = free[free < end]
        if len(before):
            begin = max(begin, int(before[-1]) + 1)
        each.append(int(spent[end + 1] - spent[begin]))
        begin = end + 1
    return each


def felt_error(law: WeberLaw, slave: Columns, master: Columns) -> FeltReport:
    """Compare the force held at each tick with the true force at the position of the same time, delays included."""
    if isinstance(law, PartsLaw):
        return next(iter(felt_parts(law, slave, master).values()))
    at_slave, at_master = matched(slave, master)
    return error_report(law, vectors(slave, "force", "n")[at_slave], vectors(master, "held", "n")[at_master])


def felt_parts(law: PartsLaw, slave: Columns, master: Columns) -> dict[str, FeltReport]:
    """Return `felt_error` of each part, by its label."""
    at_slave, at_master = matched(slave, master)
    felt = {}
    for part, own in zip(law.parts, law.laws, strict=True):
        true = np.column_stack([slave[name] for name in part.columns("force")])
        held = np.column_stack([master[name] for name in part.columns("held")])
        felt[part.label] = error_report(own, true[at_slave], held[at_master])
    return felt


def vectors(columns: Columns, quantity: str, unit: str) -> FloatArray:
    """Return a quantity of a recording on all of its axes, shape (n, a)."""
    several = [name for name in axis_columns(quantity, unit, MAX_AXES) if name in columns]
    return np.column_stack([columns[name] for name in several or axis_columns(quantity, unit, 1)])


def matched(slave: Columns, master: Columns) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the matching rows of both recordings, shape (n,) each, in order of time.

    A row of the slave matches the tick nearest in time, within half a period: a scene may also step between the sent
    positions. Of several answers for one tick the last counts.
    """
    ticks_us, steps_us = master["t_us"].astype(np.int64), slave["t_us"].astype(np.int64)
    if len(ticks_us) < 2:
        same = np.flatnonzero(np.isin(steps_us, ticks_us))[-1:]
        return same, np.zeros_like(same)
    after = np.clip(np.searchsorted(ticks_us, steps_us), 1, len(ticks_us) - 1)
    nearest = after - (steps_us - ticks_us[after - 1] < ticks_us[after] - steps_us)
    at_slave = np.flatnonzero(2 * np.abs(ticks_us[nearest] - steps_us) <= np.median(np.diff(ticks_us)))
    at_master = nearest[at_slave]
    last = np.diff(at_master, append=len(ticks_us)) != 0
    return at_slave[last], at_master[last]
