"""Quality of the applied stimuli in the measures of the field (formulas and sources: docs/understand/codecs.md)."""

import math
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.measure.metrics import FeltReport, error_report, norms, worst_window_packets
from hapticnet.perception import WeberLaw

RATE_WINDOW_US: Final = 100_000
"""Window [µs] over which the packet rate is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityReport(FeltReport):
    """Error, steps, age, burstiness and energy of the applied stimuli F̂ against the true ones F.

    The fields of `FeltReport`, and those below. The codec's multiplier does not change a JND. Without samples, values
    are 0.

    Attributes
    ----------
    peak_n
        Largest norm of a true stimulus [N], the peak of both signal-to-noise ratios.
    psnr_db
        ``10·log10(peak² / mean(|F − F̂|²))``; infinite if nothing differs.
    hpw_psnr_db
        The same with each squared error weighted by ``max(1, |F − F̂| / JND(F̂))``: perceptible errors count more.
    perceptual_mse
        Mean squared distance in JNDs on Fechner's scale; see `perceptual_distances`. None for a law without a floor,
        on whose scale a zero stimulus is infinitely far from any other.
    jump_max_jnd, jump_mean_jnd, jump_p999_jnd
        Change between successive applied stimuli in JNDs of the earlier one, which the skin feels at the time:
        largest, mean and 99.9th percentile over all samples but the first. Infinite if that JND is zero.
    send_jump_max_jnd, send_jump_mean_jnd, send_jump_p999_jnd
        The same over the samples at which an update is received.
    age_mean_us, age_max_us, age_p99_us
        Time since the applied stimulus was sent [µs], over the samples from the first update received on.
    worst_100ms_packets
        Most packets sent in any 100 ms.
    packet_rate_p999_hz
        99.9th percentile of the packet rate [1/s] over the 100 ms windows that begin at each sample.
    energy_final_j, energy_peak_j
        Energy [J] that the reconstruction has created by the end, and its maximum over time (at least 0); see
        `created_energy_j`. None without positions.
    """

    peak_n: float
    psnr_db: float
    hpw_psnr_db: float
    perceptual_mse: float | None
    jump_max_jnd: float
    jump_mean_jnd: float
    jump_p999_jnd: float
    send_jump_max_jnd: float
    send_jump_mean_jnd: float
    send_jump_p999_jnd: float
    age_mean_us: float
    age_max_us: float
    age_p99_us: float
    worst_100ms_packets: int
    packet_rate_p999_hz: float
    energy_final_j: float | None
    energy_peak_j: float | None


def quality_report(
    law: WeberLaw,
    t_us: IntArray,
    true: FloatArray,
    applied: FloatArray,
    sent: IntArray,
    positions: FloatArray | None = None,
    *,
    received: IntArray | None = None,
) -> QualityReport:
    """Measure applied stimuli [N] of shape (n, a) against the true ones, at time stamps `t_us` [µs] of shape (n,).

    Parameters
    ----------
    sent
        Indices of the transmitted stimuli, increasing, shape (m,).
    positions
        Positions of the tool [m], growing against a positive force, shape (n, a); None: unknown.
    received
        Those of `sent` that reached the receiver; None: all.
    """
    received = sent if received is None else received
    distances = norms(true - applied)
    peak_n = float(norms(true).max(initial=0.0))
    jnds = law.jnds_n(norms(applied))
    with np.errstate(divide="ignore", invalid="ignore"):
        # If the JND is zero and nothing differs, 0/0 gives NaN, which fmax ignores.
        weights = np.fmax(distances / jnds, 1.0)
        jumps = np.nan_to_num(norms(np.diff(applied, axis=0)) / jnds[:-1], nan=0.0, posinf=np.inf)
    # There is no stimulus before the first sample, so there is no jump.
    at_updates = jumps[received[received > 0] - 1]
    ages_us = _ages_us(t_us, received)
    perceived = perceptual_distances(law, true, applied)
    energy_j = None if positions is None else created_energy_j(true, applied, positions)
    return QualityReport(
        **asdict(error_report(law, true, applied)),
        peak_n=peak_n,
        psnr_db=_ratio_db(peak_n, distances * distances),
        hpw_psnr_db=_ratio_db(peak_n, weights * distances * distances),
        perceptual_mse=None if perceived is None else _mean(perceived * perceived),
        jump_max_jnd=float(jumps.max(initial=0.0)),
        jump_mean_jnd=_mean(jumps),
        jump_p999_jnd=_percentile(jumps, 99.9),
        send_jump_max_jnd=float(at_updates.max(initial=0.0)),
        send_jump_mean_jnd=_mean(at_updates),
        send_jump_p999_jnd=_percentile(at_updates, 99.9),
        age_mean_us=_mean(ages_us),
        age_max_us=float(ages_us.max(initial=0.0)),
        age_p99_us=_percentile(ages_us, 99.0),
        worst_100ms_packets=worst_window_packets(t_us[sent], RATE_WINDOW_US),
        packet_rate_p999_hz=_percentile(_packet_rates_hz(t_us, t_us[sent]), 99.9),
        energy_final_j=None if energy_j is None else float(energy_j[-1]) if len(energy_j) else 0.0,
        energy_peak_j=None if energy_j is None else float(energy_j.max(initial=0.0)),
    )


def fechner_scale(law: WeberLaw, magnitudes_n: FloatArray) -> FloatArray:
    """Return how many JNDs magnitudes [N] are from zero: the integral of 1/JND.

    With ``JND = max(k·f, floor)`` that is ``f/floor`` up to ``F₀ = floor/k``, where the two meet, and
    ``(1 + ln(f/F₀))/k`` above: Fechner's logarithm, with its origin regularised by the floor.
    """
    in_floors: FloatArray = magnitudes_n / law.floor_n
    if law.weber_fraction == 0.0:
        return in_floors
    # Above F₀ the linear part stays at 1/k; below it the logarithm is 0.
    logarithm = np.log(np.maximum(law.weber_fraction * in_floors, 1.0)) / law.weber_fraction
    scale: FloatArray = np.minimum(in_floors, 1.0 / law.weber_fraction) + logarithm
    return scale


def perceptual_distances(law: WeberLaw, true: FloatArray, applied: FloatArray) -> FloatArray | None:
    """Return how far stimuli of shape (n, a) are apart in JNDs, shape (n,); None for a law without a floor.

    ``d² = (S(|F|) − S(|F̂|))² + (|F − F̂|² − (|F| − |F̂|)²) / (JND(F)·JND(F̂))``, S the scale of `fechner_scale`. The
    first term is the difference in magnitude, the second the contribution of a change of direction: a difference of one
    JND gives about 1 in any direction, and below F₀ the result is ``|F − F̂|/floor`` exactly.
    """
    if law.floor_n == 0.0:
        return None
    true_n, applied_n = norms(true), norms(applied)
    magnitude = fechner_scale(law, true_n) - fechner_scale(law, applied_n)
    sideways = np.maximum(norms(true - applied) ** 2 - (true_n - applied_n) ** 2, 0.0)
    distances: FloatArray = np.sqrt(magnitude**2 + sideways / (law.jnds_n(true_n) * law.jnds_n(applied_n)))
    return distances


def created_energy_j(true: FloatArray, applied: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the energy [J] that the reconstruction has created up to each sample but the first, shape (n − 1,).

    ``E_n = Σ_{i<n} (F_i − F̂_i)·(x_{i+1} − x_i)``: the work of the applied force on the operator minus the work that the
    true force would have done. A positive force pushes the tool out and positions grow inwards, so the work on the
    operator is −F·dx. A force is held until the next sample.
    """
    energy: FloatArray = np.cumsum(np.sum((true - applied)[:-1] * np.diff(positions, axis=0), axis=1))
    return energy


def _ages_us(t_us: IntArray, received: IntArray) -> FloatArray:
    if not len(received):
        return np.empty(0)
    samples = np.arange(received[0], len(t_us))
    newest = received[np.searchsorted(received, samples, side="right") - 1]
    return (t_us[samples] - t_us[newest]).astype(np.float64)


def _packet_rates_hz(t_us: IntArray, sent_us: IntArray) -> FloatArray:
    ends, begins = (np.searchsorted(sent_us, at_us, side="left") for at_us in (t_us + RATE_WINDOW_US, t_us))
    return (ends - begins).astype(np.float64) * (1e6 / RATE_WINDOW_US)


def _ratio_db(peak: float, squares: FloatArray) -> float:
    mean = _mean(squares)
    return 20.0 * math.log10(peak) - 10.0 * math.log10(mean) if peak and mean else math.copysign(math.inf, peak - mean)


def _mean(values: FloatArray) -> float:
    return float(np.mean(values)) if len(values) else 0.0


def _percentile(values: FloatArray, percent: float) -> float:
    # A measured value, not an interpolated one: infinite values would give NaN, and packets are whole.
    return float(np.percentile(values, percent, method="inverted_cdf")) if len(values) else 0.0
