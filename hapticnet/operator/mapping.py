"""How movements of the hand become those of the tool, and forces of the scene those in the hand, with a clutch."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from hapticnet.capabilities import LARGEST
from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.operator.base import Operator
from hapticnet.perception import WeberLaw
from hapticnet.rotations import matrix_of
from hapticnet.samples import PositionSample, Vector

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.capabilities import Capabilities
    from hapticnet.parts import Parts

FADE_US: Final = 50_000  # time [µs] in which the force fades once the clutch is open: an assumption
RISE_US: Final = 300_000  # time [µs] in which it rises again once it is closed: an assumption
LONGEST_STEP_US: Final = 20_000  # longest time [µs] between two ticks that lets it rise


@dataclass(frozen=True, slots=True, kw_only=True)
class Mapping:
    """Scale, rotation and offset between the hand and the scene. SettingsError if a value is invalid."""

    scale: float = 1.0  # metres of the tool for a metre of the hand
    force_scale: float = 1.0  # newtons in the hand for a newton of the scene
    # Rotation from the hand's frame to that of the scene [degrees]: a rotation vector on three axes, an angle on two
    frame_deg: tuple[float, ...] = ()
    offset_m: tuple[float, ...] = ()  # where the tool is when the hand is at 0; (): at 0

    def __post_init__(self) -> None:
        check_parameter("scale of positions", self.scale, 1e-3, 1e3)
        check_parameter("scale of forces", self.force_scale, 1e-3, 1e3)
        for angle in self.frame_deg:
            check_parameter("angle of the frame", angle, -360.0, 360.0, "degrees")
        for place_m in self.offset_m:
            check_parameter("offset of the tool", place_m, -10.0, 10.0, "m")

    @classmethod
    def parse(cls, scale: float, force_scale: float, frame: str | None, offset: str | None) -> "Mapping":
        """Return the mapping of a master's options; `frame` and `offset` are numbers with commas between them."""
        return cls(
            scale=scale,
            force_scale=force_scale,
            frame_deg=_numbers("frame", frame, "degrees, as in 0,0,90"),
            offset_m=_numbers("offset", offset, "metres, as in 0.02,0,0"),
        )

    def asked(self, law: WeberLaw) -> WeberLaw:
        """Return the law to ask of a slave for a person with this one.

        The JND belongs to the hand. A share of the force is the same share of the scaled one; the floor is not.
        """
        return law if self.force_scale == 1.0 else replace(law, floor_n=law.floor_n / self.force_scale)

    def matrix(self, axes: int) -> tuple[Vector, ...] | None:
        """Return the rotation on so many axes, by rows; None: no rotation. SettingsError if it is for other axes."""
        angles = self.frame_deg
        if not any(angles):
            return None
        if (len(angles), axes) not in ((3, 3), (1, 2)):
            raise SettingsError(
                f"frame has {len(angles)} angles and the tool {axes} axes; give 3 angles, a rotation vector, on 3 axes,"
                " or 1 on 2 axes"
            )
        if axes == 3:
            return matrix_of(tuple([math.radians(each) for each in angles]))
        turn = math.radians(angles[0])
        c, s = math.cos(turn), math.sin(turn)
        return (c, -s), (s, c)


class Mapped:
    """An operator whose first part moves the tool by a mapping. Satisfies `Operator`, with `feel`.

    The clutch opens by `open`, or as long as the operator's own ``clutched`` is true. While it is open, the tool stays
    where it is and the force fades to zero; when it closes, the tool moves on from there, so that nothing jumps, and
    the force rises. Parts after the first one go through unchanged.
    """

    def __init__(self, hand: Operator, mapping: Mapping) -> None:
        self.hand: Any = hand
        self.mapping = mapping
        self.axes = hand.axes
        self.parts: Parts = getattr(hand, "parts", ())
        self.duration_us = hand.duration_us
        self.what: str = getattr(hand, "what", "the operator")
        self.open = False  # the clutch
        self._first = self.parts[0].axes if self.parts else hand.axes
        if mapping.force_scale != 1.0 and [part.kind for part in self.parts].count("force") > 1:
            raise SettingsError("the scale of forces is for one part with a force; this operator has several")
        if mapping.offset_m and len(mapping.offset_m) != self._first:
            raise SettingsError(f"offset has {len(mapping.offset_m)} coordinates; the tool has {self._first} axes")
        self._rows = mapping.matrix(self._first)
        self._columns = None if self._rows is None else tuple(zip(*self._rows, strict=True))
        self._offset_m: Vector = mapping.offset_m or (0.0,) * self._first
        self._tool_m: Vector | None = None
        self._held = False  # whether the tool was held in the newest tick
        self._share, self._t_us = 1.0, 0
        self._hand_feel: Callable[[int, Vector], None] | None = getattr(hand, "feel", None)
        moved: Capabilities | None = getattr(hand, "capabilities", None)
        force_scale = mapping.force_scale
        # What the device in the hand can do, in newtons of the scene
        self.capabilities: Capabilities | None = moved and replace(
            moved,
            max_force_n=_declared(moved.max_force_n / force_scale, "max_force_n"),
            slew_n_per_s=_declared(moved.slew_n_per_s / force_scale, "slew_n_per_s"),
        )

    @property
    def scale(self) -> float:
        """Work of a force of the scene over that in the hand, for what accounts for its energy."""
        own: float = getattr(self.hand, "scale", 1.0)
        return own * self.mapping.scale / self.mapping.force_scale

    @property
    def applied_n(self) -> Vector:
        """The force [N] that the device in the hand applies, as one of the scene; AttributeError if it is unknown."""
        applied_n: Vector = self.hand.applied_n
        first_n = _turned(self._rows, applied_n[: self._first])
        return (*[each / self.mapping.force_scale for each in first_n], *applied_n[self._first :])

    @property
    def adaptation(self) -> str | None:
        """How forces are scaled, in words; None if they are not."""
        scale, force_scale = self.mapping.scale, self.mapping.force_scale
        if scale == 1.0 == force_scale:
            return None
        stiffer = scale * force_scale
        return f"1 mm of the hand is {scale:g} mm of the tool and 1 N of the scene {force_scale:g} N in the hand," + (
            f" so that all feels {stiffer:g} times as stiff" if stiffer != 1.0 else " so that stiffness is true"
        )

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is at `t_us` [µs]."""
        position_m: Vector = self.hand.sample(t_us).position_m
        scale = self.mapping.scale
        at_m = _turned(self._rows, position_m[: self._first])
        if scale != 1.0:
            at_m = tuple([scale * each for each in at_m])
        tool_m = self._tool_m
        opened = self.open or bool(getattr(self.hand, "clutched", False))
        if opened and tool_m is not None:
            self._held = True
        else:
            if self._held and tool_m is not None:  # from here on, the tool moves as the hand does
                self._offset_m = tuple([held - at for held, at in zip(tool_m, at_m, strict=True)])
            self._held = opened
            tool_m = tuple([at + offset for at, offset in zip(at_m, self._offset_m, strict=True)])
            self._tool_m = tool_m
        step_us, self._t_us = min(max(0, t_us - self._t_us), LONGEST_STEP_US), t_us
        self._share = max(0.0, self._share - step_us / FADE_US) if opened else min(1.0, self._share + step_us / RISE_US)
        return PositionSample(t_us, (*tool_m, *position_m[self._first :]))

    def feel(self, t_us: int, force_n: Vector) -> None:
        """Let the hand feel a force [N] of the scene."""
        if self._hand_feel is not None:
            self._hand_feel(t_us, self.to_hand(force_n))

    def to_hand(self, force_n: Vector) -> Vector:
        """Return a force [N] of the scene as the one in the hand, in its frame."""
        share = self._share * self.mapping.force_scale
        first_n = _turned(self._columns, force_n[: self._first])
        if share != 1.0:
            first_n = tuple([share * each for each in first_n])
        return (*first_n, *force_n[self._first :])


def mapped(operator: Operator, mapping: Mapping) -> Operator:
    """Return the operator with its mapping; itself if nothing is mapped and it has no clutch."""
    if mapping == Mapping() and getattr(operator, "clutched", None) is None:
        return operator
    return Mapped(operator, mapping)


def _declared(value: float, name: str) -> float:
    """Return a limit of a device in units of the scene; the largest one that a device may declare, if it is larger."""
    return value if value == math.inf else min(value, LARGEST[name][0])


def _turned(rows: tuple[Vector, ...] | None, vector: Vector) -> Vector:
    if rows is None:
        return vector
    return tuple([sum([a * b for a, b in zip(row, vector, strict=True)]) for row in rows])


def _numbers(name: str, text: str | None, wanted: str) -> tuple[float, ...]:
    try:
        numbers = tuple([float(each) for each in text.split(",")]) if text else ()
    except ValueError:
        raise SettingsError(f"{name} is {text!r}; it must be 1 to 3 numbers of {wanted}") from None
    if len(numbers) > 3:
        raise SettingsError(f"{name} has {len(numbers)} numbers; it must be 1 to 3 of {wanted}")
    return numbers
