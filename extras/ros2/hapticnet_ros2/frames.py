"""The parts that a robot or leader exchanges, and hapticnet's axes in its frame."""

import math
from collections.abc import Sequence
from typing import Final

from hapticnet.errors import SettingsError
from hapticnet.rotations import Quaternion, inverse, rotated
from hapticnet.samples import Vector
from hapticnet_ros2.settings import axes_from

PARTS: Final = "force", "torque", "grip"
WRENCH_AXES: Final = "base", "tool"


class Frame:
    """Axes such as ``-zxy`` and parts such as ``force+torque+grip``; SettingsError if they are invalid.

    Attributes
    ----------
    parts
        As in `hapticnet.parts`.
    turns, grips
        Whether there is a torque and an orientation, and whether there is a grip and an opening.
    is_tool
        Whether wrenches are along the axes of the tool, and turn with it.
    """

    def __init__(self, axes: str | float, parts: str, wrench_axes: str) -> None:
        self.along = axes_from(axes)
        kinds = str(parts).split("+")
        if kinds[0] != "force" or kinds != [each for each in PARTS if each in kinds]:
            raise SettingsError(f"parts is {parts!r}; it must be force, force+torque, force+grip or force+torque+grip")
        self.turns, self.grips = "torque" in kinds, "grip" in kinds
        if self.turns and len(self.along) < 3:
            raise SettingsError(f"axes is {axes!r}; an orientation and a torque need three, as in axes=xyz")
        if wrench_axes not in WRENCH_AXES:
            raise SettingsError(f"wrench_axes is {wrench_axes!r}; it must be {' or '.join(WRENCH_AXES)}")
        self.is_tool = wrench_axes == "tool"
        count = len(self.along)
        self.parts = tuple([f"{each}:{1 if each == 'grip' else count}" for each in kinds])
        self.turn_at = slice(count, 2 * count if self.turns else count)
        self._hand = math.prod(sign for _, sign in self.along)
        if self.turns:  # axes that are a mirror image of the frame's turn the other way round
            a, b, c = (axis for axis, _ in self.along)
            self._hand *= math.copysign(1.0, (b - a) * (c - b) * (c - a))

    @property
    def text(self) -> str:
        """The axes in words, such as "-z, +x, +y"."""
        return ", ".join(f"{'-' if sign < 0.0 else '+'}{'xyz'[axis]}" for axis, sign in self.along)

    def seen(self, vector: Sequence[float]) -> Vector:
        """Return a vector of the frame along hapticnet's axes."""
        return tuple([sign * vector[axis] for axis, sign in self.along])

    def shown(self, vector: Sequence[float]) -> Vector:
        """Return a vector along hapticnet's axes in the frame; 0 along the axes that hapticnet does not have."""
        made = [0.0, 0.0, 0.0]
        for (axis, sign), each in zip(self.along, vector, strict=True):
            made[axis] = sign * each
        return tuple(made)

    def turn_seen(self, vector: Sequence[float]) -> Vector:
        """Return a torque, or the vector of a quaternion, along hapticnet's axes."""
        return tuple([self._hand * each for each in self.seen(vector)])

    def turn_shown(self, vector: Sequence[float]) -> Vector:
        """Return a torque, or the vector of a quaternion, in the frame."""
        return tuple([self._hand * each for each in self.shown(vector)])

    def wrench_seen(self, wrench: Vector, tool: Quaternion | None) -> tuple[Vector, Vector]:
        """Return force and torque along hapticnet's axes; `tool` is the tool's orientation if the wrench is in it."""
        force, torque = wrench[:3], wrench[3:]
        if tool is not None:
            force, torque = rotated(force, tool), rotated(torque, tool)
        return self.seen(force), self.turn_seen(torque) if self.turns else ()

    def wrench_shown(self, force: Vector, torque: Vector, tool: Quaternion | None) -> Vector:
        """Return force and torque in the frame, or in the axes of a tool of this orientation."""
        shown = self.shown(force), self.turn_shown(torque) if self.turns else (0.0, 0.0, 0.0)
        if tool is not None:
            shown = rotated(shown[0], inverse(tool)), rotated(shown[1], inverse(tool))
        return *shown[0], *shown[1]
