"""The motion of the tool, from its positions so far: what both sides of a codec make of the same positions."""

from typing import NamedTuple

from hapticnet.samples import Vector
from hapticnet.vectors import along, minus, over


class Motion(NamedTuple):
    """The newest position of the tool, and its velocity.

    Attributes
    ----------
    is_known
        Whether there has been a position at all.
    samples
        Number of positions in a row up to the present sample; 0 if that of the present one is not known.
    t_us, position, velocity
        Time [µs], position [m] and velocity [m/s] of the newest one.
    """

    is_known: bool
    samples: int
    t_us: int
    position: Vector
    velocity: Vector


def unknown_motion(axes: int) -> Motion:
    """Return the motion before the first position."""
    zeros = (0.0,) * axes
    return Motion(False, 0, 0, zeros, zeros)


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
    if motion.is_known and t_us == motion.t_us:
        return motion
    if motion.is_known and t_us > motion.t_us:
        traveled = along(minus(position, motion.position), lag_s, motion.velocity)
        velocity = over(traveled, lag_s + (t_us - motion.t_us) * 1e-6)
    else:
        velocity = minus(position, position)
    return Motion(True, motion.samples + 1, t_us, position, velocity)


def unseen(motion: Motion) -> Motion:
    """Return the motion at a sample whose position is not known: as before, because the receiver knows no better."""
    return motion._replace(samples=0)
