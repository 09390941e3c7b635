"""Measures of error and the fewest packets possible, for forces and times as users give them."""

from typing import Any

import numpy as np
import numpy.typing as npt

from hapticnet.api.inputs import ForceLike, as_forces, check_shapes, read_trial
from hapticnet.arrays import FloatArray
from hapticnet.errors import SampleError
from hapticnet.measure import bound, energy, metrics, quality
from hapticnet.measure.energy import EnergyReport
from hapticnet.measure.metrics import FeltReport
from hapticnet.measure.quality import QualityReport
from hapticnet.perception import WeberLaw

PAPER_LAW = WeberLaw()


def error_report(true: npt.ArrayLike, applied: npt.ArrayLike, *, law: WeberLaw = PAPER_LAW) -> FeltReport:
    """Compare the applied forces with the true ones.

    Parameters
    ----------
    true, applied
        Forces [N], shape (n,) or (n, a) with 1 to 3 axes; the shapes must match.
    law
        The perceptual law of the person; its multiplier does not matter.

    Raises
    ------
    SampleError
        If they are not finite numbers of the same shape.
    """
    return metrics.error_report(law, *_pair(true, applied))


def quality_report(
    true: npt.ArrayLike,
    applied: npt.ArrayLike,
    *,
    sent: npt.ArrayLike,
    rate_hz: float | None = None,
    t_s: npt.ArrayLike | None = None,
    t_us: npt.ArrayLike | None = None,
    position: npt.ArrayLike | None = None,
    received: npt.ArrayLike | None = None,
    law: WeberLaw = PAPER_LAW,
) -> QualityReport:
    """Measure error, steps, age, burstiness and energy of the applied forces.

    Parameters
    ----------
    true, applied, law
        As for `error_report`.
    sent, received
        Indices of the transmitted samples, increasing, shape (m,), and of those that arrived (default: all).
    rate_hz, t_s, t_us, position
        As for `encode`.

    Raises
    ------
    SampleError
        If a recording cannot be used, or an index is out of range.
    SettingsError
        If times are given twice.
    """
    forces, applied_n = _pair(true, applied)
    trial = read_trial(forces, rate_hz=rate_hz, t_s=t_s, t_us=t_us, position=position, name="true")
    indices = _indices(sent, "sent", len(forces))
    arrived = None if received is None else _indices(received, "received", len(forces))
    return quality.quality_report(law, trial.t_us, forces, applied_n, indices, trial.positions, received=arrived)


def energy_report(
    true: npt.ArrayLike, applied: npt.ArrayLike, *, position: npt.ArrayLike, law: WeberLaw = PAPER_LAW
) -> EnergyReport:
    """Account for the energy at the master's port: what the hand puts in, and what the applied forces create.

    Parameters
    ----------
    true, applied, law
        As for `error_report`; forces are positive when they push the tool out.
    position
        Positions [m], which increase inward, of the same shape.

    Raises
    ------
    SampleError
        If they are not finite numbers of the same shape.
    """
    forces, applied_n = _pair(true, applied)
    positions = _finite(position, "position")
    check_shapes(positions, forces, "position", "true")
    return energy.energy_report(law, forces, applied_n, positions)


def fewest_holds(force: ForceLike, *, law: WeberLaw = PAPER_LAW) -> int:
    """Return the fewest packets with which a zero-order hold stays within the threshold at every sample.

    One axis: the optimum, which requires knowing the future. Two or three: a lower bound.

    Parameters
    ----------
    force
        As for `encode`.
    law
        The law that gives the threshold.

    Raises
    ------
    SampleError
        If the forces cannot be used.
    """
    return bound.fewest_holds(law, read_trial(force, rate_hz=None, t_s=None, t_us=None, position=None).stimuli)


def fewest_lines(
    force: ForceLike,
    *,
    rate_hz: float | None = None,
    t_s: npt.ArrayLike | None = None,
    t_us: npt.ArrayLike | None = None,
    law: WeberLaw = PAPER_LAW,
) -> int:
    """Return the fewest straight lines that stay within the threshold at every sample; see `fewest_holds`.

    Parameters
    ----------
    force, rate_hz, t_s, t_us
        As for `encode`.
    law
        The law that gives the threshold.

    Raises
    ------
    SampleError
        If the forces or times cannot be used.
    SettingsError
        If times are given twice.
    """
    trial = read_trial(force, rate_hz=rate_hz, t_s=t_s, t_us=t_us, position=None)
    return bound.fewest_lines(law, trial.t_us, trial.stimuli)


def _pair(true: npt.ArrayLike, applied: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    forces, applied_n = _finite(true, "true"), _finite(applied, "applied")
    check_shapes(applied_n, forces, "applied", "true")
    return forces, applied_n


def _finite(values: npt.ArrayLike, name: str) -> FloatArray:
    forces = as_forces(values, name)
    if not np.isfinite(forces).all():
        raise SampleError(f"{name}[{int(np.argmin(np.isfinite(forces).all(axis=1)))}] is not finite")
    return forces


def _indices(values: npt.ArrayLike, name: str, samples: int) -> npt.NDArray[np.int64]:
    indices: npt.NDArray[Any] = np.asarray(values)
    good = indices.ndim == 1 and (indices.dtype.kind in "iu" or not indices.size)
    if not good or (np.diff(indices) <= 0).any() or (indices.size and not 0 <= indices[0] <= indices[-1] < samples):
        raise SampleError(f"{name} must be increasing indices from 0 to {samples - 1}, as `encode(...).sent` is")
    return indices.astype(np.int64)
