"""Energy at the master's port: energy that the hand puts in, and that a codec, a delay or a loss creates.

A port is passive if no more energy comes out of it than went in, whatever the hand does. The passivity observer of
Hannaford and Ryu, "Time-domain passivity control of haptic interfaces" (2002), sums force times motion and finds a port
active when the sum falls below zero. One sum over a whole recording hides much: a breach that absorbs energy pays for
all energy created later. Here every contact has its own account, which begins at zero.
"""

from dataclasses import dataclass

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.measure.metrics import norms
from hapticnet.perception import WeberLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyReport:
    """Energy [J] at the port where the hand moves the tool against the applied force.

    A contact begins when the true or the applied force exceeds the floor of the law, and ends when neither does. Each
    force acts until the next sample, as the device holds it.
    """

    put_in_j: float
    """Work that the hand would do against the true force: the sum over the samples at which it is positive."""
    created_j: float
    """Energy that the applied force creates compared with the true one: in each contact, the largest advantage of the
    hand (it had to put in less, or got more back), summed over the contacts."""
    active_j: float
    """Energy that comes out of the port beyond what went in: in each contact the lowest value of the passivity
    observer, ``−min Σ F̂·Δx``, where that is negative, summed. A true force held from sample to sample is itself
    slightly active."""

    @property
    def created_share(self) -> float:
        """`created_j` over `put_in_j`; 0 if the hand does no work."""
        return self.created_j / self.put_in_j if self.put_in_j else 0.0

    @property
    def active_share(self) -> float:
        """`active_j` over `put_in_j`; 0 if the hand does no work."""
        return self.active_j / self.put_in_j if self.put_in_j else 0.0


def energy_report(law: WeberLaw, true: FloatArray, applied: FloatArray, positions: FloatArray) -> EnergyReport:
    """Account for the energy of applied forces [N], positive when they push the tool out, shape (n, a).

    Positions [m] increase inward. The floor of the law separates contact from noise.
    """
    moves = np.diff(positions, axis=0)
    asked_j = np.sum(true[:-1] * moves, axis=1)
    given_j = np.sum(applied[:-1] * moves, axis=1)
    touches = np.maximum(norms(true[:-1]), norms(applied[:-1])) > law.floor_n
    created_j = active_j = 0.0
    for contact in _runs(touches):
        created_j += max(0.0, float(np.cumsum(asked_j[contact] - given_j[contact]).max()))
        active_j += max(0.0, -float(np.cumsum(given_j[contact]).min()))
    put_in_j = float(asked_j[touches & (asked_j > 0.0)].sum())
    return EnergyReport(put_in_j=put_in_j, created_j=created_j, active_j=active_j)


def _runs(flags: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]") -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [slice(begin, end) for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]
