"""What positions say about a force: a local stiffness, and a stiffness and viscosity that are learned."""

from typing import Final, NamedTuple

from hapticnet.codec.schemes.motion import Motion
from hapticnet.codec.steps import Table
from hapticnet.samples import Vector
from hapticnet.vectors import dot, magnitude, minus, over, row

LOCAL_US: Final = 15_000  # length of the window in which the local stiffness is estimated [µs]
LEAST_PERIODS: Final = 3  # shortest window in sampling periods

PRIOR_SQUARE_M2: Final = 1e-9
"""Weight of the learned stiffness in the local one, as a sum of squared movements [m²]: 15 samples of 8 µm. A tool that
hardly moves says little about the stiffness, and a slope of noise over noise would be applied at its next move."""

APART_US: Final = 30_000
"""Distance of the samples for the differences in the regression of stiffness [µs]: long enough that the hand has
moved further than the noise of its positions."""

MEMORY_US: Final = 3e6  # time constant for forgetting such differences [µs]: a few movements of a hand

RIDGE_STIFFNESS: Final = 3e-10
RIDGE_VISCOSITY: Final = 1.3e-9
"""Weight of zero in the regression, in squared thresholds per squared N/m and N·s/m. They only matter at rest."""

LARGEST_CHANGE: Final = 1e6  # differences whose squared force, in thresholds, is larger are ignored: they are impacts

LARGEST_MOTION: Final = 1e18
"""The same for squared movements [m per threshold of a newton]; keeps the equations well conditioned."""

SMALLEST_THRESHOLD_N: Final = 1e-100


class Coupling(NamedTuple):
    """Recursive least squares with forgetting: how changes of force depend on changes of position and velocity."""

    # The sample to which the next difference is taken
    has_anchor: bool
    t_us: int
    stimulus: Vector
    position: Vector
    velocity: Vector
    # Normal equations, in thresholds: the upper triangle row by row, and the right-hand side
    normal: tuple[float, float, float]
    right: tuple[float, float]
    # Their solution [N/m, N·s/m], both not negative
    stiffness: float
    viscosity: float


def no_coupling(axes: int) -> Coupling:
    """Return the state before the first sample."""
    zeros = (0.0,) * axes
    return Coupling(False, 0, zeros, zeros, zeros, (0.0, 0.0, 0.0), (0.0, 0.0), 0.0, 0.0)


def is_due(coupling: Coupling, motion: Motion, t_us: int) -> bool:
    """Return whether to observe a sample: one every `APART_US`, if its position is known."""
    _, samples, _, _, _ = motion
    return samples > 0 and not (coupling.has_anchor and 0 <= t_us - coupling.t_us < APART_US)


def observed(coupling: Coupling, motion: Motion, t_us: int, x: Vector, threshold_n: float) -> Coupling:
    """Return the coupling after a sample that is due: learn from the difference to an earlier one."""
    _, _, _, position, velocity = motion
    _, _, _, _, _, normal, right, stiffness, viscosity = coupling
    if coupling.has_anchor:
        apart_us = t_us - coupling.t_us
        if 0 < apart_us < MEMORY_US and threshold_n > SMALLEST_THRESHOLD_N:
            scale = 1.0 / threshold_n
            dx, dv = minus(position, coupling.position), minus(velocity, coupling.velocity)
            change = minus(x, coupling.stimulus)
            square = scale * scale
            xx, xv, vv = square * dot(dx, dx), square * dot(dx, dv), square * dot(dv, dv)
            if xx + vv <= LARGEST_MOTION and square * dot(change, change) <= LARGEST_CHANGE:
                keep = MEMORY_US / (MEMORY_US + apart_us)
                a, b, c = normal
                p, q = right
                a, b, c = keep * a + xx, keep * b + xv, keep * c + vv
                p, q = keep * p + square * dot(dx, change), keep * q + square * dot(dv, change)
                normal, right = (a, b, c), (p, q)
                stiffness, viscosity = solved(normal, right)
    return Coupling(True, t_us, x, position, velocity, normal, right, stiffness, viscosity)


def solved(normal: tuple[float, float, float], right: tuple[float, float]) -> tuple[float, float]:
    """Return stiffness and viscosity that solve the normal equations, each at least 0."""
    a, b, c = normal
    p, q = right
    a += RIDGE_STIFFNESS
    c += RIDGE_VISCOSITY
    determinant = a * c - b * b
    if not determinant > 0.0:
        return max(0.0, p / a), 0.0
    stiffness, viscosity = (c * p - b * q) / determinant, (a * q - b * p) / determinant
    if stiffness < 0.0:
        return 0.0, max(0.0, q / c)
    if viscosity < 0.0:
        return max(0.0, p / a), 0.0
    return stiffness, viscosity


def local_stiffness(
    times_us: list[float],
    samples: Table,
    positions: Table,
    first: int,
    newest: int,
    band_n: float,
    learned: float,
    like: Vector,
) -> tuple[float, float, Vector]:
    """Return the stiffness [N/m] of a surface that is touched along and across its normal, and the normal.

    The normal is the direction of the force. Across it, a curved surface has a stiffness because its normal turns.

    It is the slope, along the normal, of a line through the newest sample, fitted to those of the last `LOCAL_US`. A
    sample without force, or further than `band_n` from the line so far, ends the window, because there was an impact.
    After hardly any movement, it is the learned stiffness. Stiffness 0 if there is no force. `like` is any vector
    with as many axes.
    """
    x, at = row(samples, newest, like), row(positions, newest, like)
    size = magnitude(x)
    if not size > SMALLEST_THRESHOLD_N:
        return 0.0, 0.0, x
    normal = over(x, size)
    square = product = square_across = product_across = 0.0
    for k in range(newest - 1, first - 1, -1):
        if times_us[newest] - times_us[k] > LOCAL_US and newest - k > LEAST_PERIODS:
            break
        if len(like) == 1:  # inlined from below, because this runs for many samples
            force = samples[k][0]
            if force == 0.0:
                break
            moved, change = normal[0] * (positions[k][0] - at[0]), normal[0] * (force - x[0])
            more_square = more_product = 0.0
        else:
            then = row(samples, k, like)
            if magnitude(then) == 0.0:
                break
            movement, difference = minus(row(positions, k, like), at), minus(then, x)
            moved, change = dot(normal, movement), dot(normal, difference)
            more_square = dot(movement, movement) - moved * moved
            more_product = dot(movement, difference) - moved * change
        if square > 0.0 and not abs(change - product / square * moved) <= band_n:
            break
        square += moved * moved
        product += moved * change
        square_across += more_square
        product_across += more_product
    across = 0.0
    if len(x) > 1 and square_across >= PRIOR_SQUARE_M2:
        across = max(0.0, product_across / square_across)
    if square < PRIOR_SQUARE_M2:
        return learned, across, normal
    return max(0.0, product / square), across, normal
