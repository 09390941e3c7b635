"""The motion of the tool, from its positions so far: what both sides of a codec make of the same positions."""

from typing import TypeAlias

from hapticnet.samples import Vector
from hapticnet.vectors import along, minus, over

Motion: TypeAlias = tuple[bool, int, int, Vector, Vector]
"""``(is_known, samples, t_us, position, velocity)`` of the tool.

A plain tuple, because there is a new one at every sample, and a named tuple takes ten times as long to make.

is_known
    Whether there has been a position at all.
samples
    Number of positions in a row up to the present sample; 0 if that of the present one is not known.
t_us, position, velocity
    Time [µs], position [m] and velocity [m/s] of the newest one.
"""


def unknown_motion(axes: int) -> Motion:
    """Return the motion before the first position."""
    zeros = (0.0,) * axes
    return False, 0, 0, zeros, zeros


def moved_on(motion: Motion, t_us: int, position: Vector, lag_s: float) -> Motion:
    """Return the motion after a position.

    The velocity is the low-passed difference quotient: ``v ← (τ·v + p - p_before) / (τ + dt)``, backward Euler of
    ``τ·dv/dt = dp/dt - v``, per axis. The tool counts as at rest after the first position, and after one whose time
    stamp goes back. A repeated time stamp is ignored.

    Parameters
    ----------
    lag_s
        The time constant τ [s].
    """
    is_known, samples, before_us, before, velocity = motion
    if not (is_known and t_us >= before_us):
        return True, samples + 1, t_us, position, minus(position, position)
    if t_us == before_us:
        return motion
    elapsed_s = (t_us - before_us) * 1e-6
    if len(position) == 1:  # as below without three calls, because this runs at every sample
        velocity = ((position[0] - before[0] + lag_s * velocity[0]) / (lag_s + elapsed_s),)
    else:
        velocity = over(along(minus(position, before), lag_s, velocity), lag_s + elapsed_s)
    return True, samples + 1, t_us, position, velocity


def unseen(motion: Motion) -> Motion:
    """Return the motion at a sample whose position is not known: as before, because the receiver knows no better."""
    is_known, _, t_us, position, velocity = motion
    return is_known, 0, t_us, position, velocity
