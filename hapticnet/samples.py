"""Position and force samples: the two kinds of data in hapticnet.

A vector is a tuple of floats, one per axis, because numpy costs tens of microseconds on a single sample.
"""

from collections.abc import Iterable
from typing import Final, NamedTuple, TypeAlias

from hapticnet.errors import SampleError

Vector: TypeAlias = tuple[float, ...]

new_tuple: Final = tuple.__new__
"""Makes a named tuple from a tuple, in half the time of its own constructor, for the path of every sample."""

MAX_AXES = 3  # of one part of a vector, such as a force
MOST_COMPONENTS: Final = 24  # of a vector of several parts (`parts`): a hand's pose and wrench, and five fingertips
LARGEST_COMPONENT = 1e15
"""Largest magnitude of one component, in SI units. Far above any haptic value, but its squares stay finite."""


class PositionSample(NamedTuple):
    """The position of the operator's tool tip at one time.

    Attributes
    ----------
    t_us
        Sampling time [µs] on the master's monotonic clock.
    position_m
        Position [m], one value per axis. On the needle's axis it increases into the tissue.
    """

    t_us: int
    position_m: Vector


class ForceSample(NamedTuple):
    """The contact force that belongs to one position sample.

    Attributes
    ----------
    t_us
        Sampling time [µs] of the position this force answers, on the master's monotonic clock.
    force_n
        Force [N], one value per axis, positive when it pushes the operator out of the tissue.
    """

    t_us: int
    force_n: Vector


def checked_vector(values: Iterable[float], what: str) -> Vector:
    """Return `values` as a vector, refusing invalid ones.

    Raise SampleError if there are no components or more than `MOST_COMPONENTS`, or one of them is NaN, infinite or
    beyond `LARGEST_COMPONENT`.
    """
    if type(values) is tuple and len(values) == 1:  # the common case, in a third of the time
        (x,) = values
        if type(x) is float and -LARGEST_COMPONENT <= x <= LARGEST_COMPONENT:
            return values
    vector = tuple(map(float, values))
    if not 1 <= len(vector) <= MOST_COMPONENTS:
        raise SampleError(f"{what} has {len(vector)} axes; 1 to {MOST_COMPONENTS} are supported")
    for component in vector:
        # Written so that NaN, which compares false with everything, is refused too.
        if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
            raise SampleError(f"{what} is {component}; it must be finite and within ±{LARGEST_COMPONENT:g}")
    return vector
