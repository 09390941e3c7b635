"""Stimuli of several parts: force, torque and grip, or the forces at several fingers, each with its own threshold.

A vector of parts is one flat tuple, part after part: for the parts ``force:3``, ``torque:3`` and ``grip:1``, positions
``(x, y, z, rx, ry, rz, opening)`` and stimuli ``(fx, fy, fz, tx, ty, tz, grip)``. Newtons and newton metres have no
common norm, so each part is compared with its own threshold: two stimuli differ if one part does.

On every axis a stimulus is positive where it resists an increase of its position, so that stimulus times movement is
the work of the hand [J]; a grip that opens the fingers is negative. An orientation is a rotation vector [rad] in the
scene's frame. It is continuous: of the vectors for one orientation it is the nearest to the last, so its norm may
exceed π. A torque works along the turn itself: the difference of two rotation vectors is that turn only about a fixed
axis.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self, TypeAlias, TypedDict

from hapticnet.errors import SettingsError
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.samples import MAX_AXES, MOST_COMPONENTS, Vector
from hapticnet.user_code import attribute_of, axes_of, short
from hapticnet.vectors import distance, magnitude

AXIS_NAMES: Final = ("x", "y", "z")


class Kind(NamedTuple):
    """What a part is: its position and stimulus with their units in names of columns, and its threshold."""

    position: str
    position_unit: str
    stimulus: str
    unit: str
    weber_fraction: float
    floor: float  # smallest threshold [unit of the stimulus]
    m_per_unit: float  # movement [m] that counts as much as one unit of the position
    axes: tuple[int, ...] = (1, 2, 3)


LEVER_M: Final = 0.1
"""A rotation counts as the movement of a point at this distance [m]: the length of a hand-held tool."""

KINDS: Final[Mapping[str, Kind]] = {
    "force": Kind("position", "m", "force", "n", PAPER_WEBER_FRACTION, PAPER_FLOOR_N, 1.0),
    # 12.7 % at 60 mN·m, pinch grasp (Jandura and Srinivasan 1994, "Experiments on human performance in torque
    # discrimination and control"). Constant below the only reference tested, as for forces.
    "torque": Kind("rotation", "rad", "torque", "nm", 0.127, 0.127 * 0.06, LEVER_M),
    # 7 % from 2.5 to 10 N, thumb against forefinger (Pang, Tan and Durlach 1991, "Manual discrimination of force using
    # active finger motion"). Constant below the weakest reference tested.
    "grip": Kind("opening", "m", "grip", "n", 0.07, 0.07 * 2.5, 1.0, (1,)),
}

_FORM: Final = re.compile(r"([a-z]+):([1-9])(?:@([a-z][a-z0-9-]{0,15}))?")


class Part(NamedTuple):
    """One part of a vector, written ``KIND:AXES``, or ``KIND:AXES@NAME`` where there are several of a kind."""

    kind: str
    axes: int
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind}:{self.axes}" + (f"@{self.name}" if self.name else "")

    @property
    def label(self) -> str:
        """Its name in reports: the kind, and the name if it has one."""
        return f"{self.kind}@{self.name}" if self.name else self.kind

    def columns(self, quantity: str, *, is_position: bool = False) -> tuple[str, ...]:
        """Return the names of columns of its position, or of a stimulus such as "force", "received" or "held"."""
        kind = KINDS[self.kind]
        if is_position:
            quantity, unit = kind.position, kind.position_unit
        else:
            unit = kind.unit
            if self.kind != "force":
                quantity = kind.stimulus if quantity == "force" else f"{quantity}_{kind.stimulus}"
        quantity = f"{self.name}_{quantity}" if self.name else quantity
        if self.axes == 1:
            return (f"{quantity}_{unit}",)
        return tuple(f"{quantity}_{axis}_{unit}" for axis in AXIS_NAMES[: self.axes])


Parts: TypeAlias = tuple[Part, ...]


def parse_parts(texts: Iterable[object]) -> Parts:
    """Return the parts written in `texts`; SettingsError if one is malformed or twice, or they are too many axes."""
    given = list(texts)
    parts = []
    for text in given:
        found = _FORM.fullmatch(text) if isinstance(text, str) else None
        kind = KINDS.get(found[1]) if found else None
        if found is None or kind is None or int(found[2]) not in kind.axes:
            raise SettingsError(
                f"part {str(text)[:40]!r} must be KIND:AXES or KIND:AXES@NAME, as in force:3, torque:3, grip:1 or"
                f" force:3@thumb; kinds are {', '.join(KINDS)}, with 1 to {MAX_AXES} axes (grip: 1)"
            )
        parts.append(Part(found[1], int(found[2]), found[3] or ""))
    if len({part.label for part in parts}) < len(parts):
        raise SettingsError(
            f"two of the parts {' '.join(map(str, given))} are the same; name them, as in force:3@thumb"
        )
    if not 1 <= total_axes(parts) <= MOST_COMPONENTS:
        raise SettingsError(f"the parts have {total_axes(parts)} axes; 1 to {MOST_COMPONENTS} are supported")
    return tuple(parts)


def total_axes(parts: Sequence[Part]) -> int:
    """Return the number of axes of all parts."""
    return sum(part.axes for part in parts)


def force_axes(axes: int, parts: Sequence[Part]) -> int:
    """Return the number of axes of the force that a stimulus begins with; 0 if its first part is another quantity."""
    return axes if not parts else parts[0].axes if parts[0].kind == "force" else 0


def written(parts: Sequence[Part] | None, axes: int) -> str:
    """Return the parts in words, such as "force:3 torque:3", or the axes of a stimulus without parts: "force:1"."""
    return " ".join(map(str, parts)) if parts else f"force:{axes}"


def declared(made: object, what: str) -> tuple[int, Parts]:
    """Return the number of axes of a user's object, and its parts if it declares several in ``parts``.

    Raise SettingsError if one of them is invalid; `what` starts the message.
    """
    texts = attribute_of(made, "parts", None, what)
    if texts is None:
        return axes_of(made, what), ()
    if isinstance(texts, str) or not isinstance(texts, Iterable):
        raise SettingsError(f"{what}: parts is {short(texts)}; it must be a sequence, such as ('force:3', 'torque:3')")
    try:
        parts = parse_parts(texts)
    except SettingsError as error:
        raise SettingsError(f"{what}: {error}") from error
    is_one_force = [part.label for part in parts] == ["force"]
    return total_axes(parts), () if is_one_force else parts


@dataclass(frozen=True, slots=True, kw_only=True)
class PartsLaw(WeberLaw):
    """The thresholds of several parts. `weber_fraction` and `floor_n` are those of forces; the multiplier is common.

    Attributes
    ----------
    parts
        The parts, in the order of the vector.
    others
        Kind, Weber fraction and smallest threshold of each kind other than force whose published values do not apply.
    """

    parts: Parts = ()
    others: tuple[tuple[str, float, float], ...] = ()

    @property
    def laws(self) -> tuple[WeberLaw, ...]:
        """The law of each part."""
        return tuple(map(self._law, self.parts))

    @property
    def axes(self) -> int:
        """Number of axes of all parts."""
        return total_axes(self.parts)

    def slices(self) -> tuple[slice, ...]:
        """Return where each part stands in a vector."""
        ends = [total_axes(self.parts[: index + 1]) for index in range(len(self.parts))]
        return tuple(slice(end - part.axes, end) for part, end in zip(self.parts, ends, strict=True))

    def _law(self, part: Part) -> WeberLaw:
        kind = KINDS[part.kind]
        weber_fraction, floor = (
            (self.weber_fraction, self.floor_n) if part.kind == "force" else (kind.weber_fraction, kind.floor)
        )
        for name, other_fraction, other_floor in self.others:
            if name == part.kind:
                weber_fraction, floor = other_fraction, other_floor
        return WeberLaw(weber_fraction=weber_fraction, floor_n=floor, multiplier=self.multiplier)

    @classmethod
    def of(cls, parts: Parts, law: WeberLaw, others: Mapping[str, tuple[float, float]] | None = None) -> Self:
        """Return the law of parts for a person whose law of forces is `law`; SettingsError if `others` is unusable."""
        for kind in others or {}:
            if kind not in KINDS or kind == "force":
                raise SettingsError(f"threshold of {kind!r}; it must be one of {', '.join(list(KINDS)[1:])}")
        made = cls(
            weber_fraction=law.weber_fraction,
            floor_n=law.floor_n,
            multiplier=law.multiplier,
            parts=parts,
            others=tuple((kind, float(numbers[0]), float(numbers[1])) for kind, numbers in (others or {}).items()),
        )
        for part, each in zip(parts, made.laws, strict=True):  # which checks the numbers
            if not each.floor_n > 0.0:
                raise SettingsError(f"the smallest threshold of {part.label} is {each.floor_n}; it must be above 0")
        return made


def parts_of(law: WeberLaw) -> Parts:
    """Return the parts of a law; none for one of forces only."""
    return law.parts if isinstance(law, PartsLaw) else ()


class LawNumbers(TypedDict):
    """The numbers of a law of forces."""

    weber_fraction: float
    floor_n: float
    multiplier: float


def law_numbers(law: WeberLaw) -> LawNumbers:
    """Return the numbers of a law of forces by name."""
    return {"weber_fraction": law.weber_fraction, "floor_n": law.floor_n, "multiplier": law.multiplier}


def with_numbers(law: WeberLaw, numbers: WeberLaw) -> WeberLaw:
    """Return the law with the numbers of another law of forces; its parts stay."""
    return replace(law, **law_numbers(numbers)) if isinstance(law, PartsLaw) else numbers


def parts_request(law: WeberLaw) -> tuple[tuple[str, ...], dict[str, tuple[float, float]]] | None:
    """Return the parts and the thresholds of their kinds for a `Request`; None without parts."""
    if not isinstance(law, PartsLaw):
        return None
    numbers = {
        part.kind: (each.weber_fraction, each.floor_n)
        for part, each in zip(law.parts, law.laws, strict=True)
        if part.kind != "force"
    }
    return tuple(map(str, law.parts)), numbers


def size_function(law: WeberLaw) -> Callable[[Vector], float]:
    """Return the function that gives the magnitude [N] of a stimulus.

    Of several parts it is the largest, each scaled so that the smallest thresholds of all are equal.
    """
    if not isinstance(law, PartsLaw):
        return magnitude
    laws = law.laws
    scaled = [(each, laws[0].floor_n / own.floor_n) for each, own in zip(law.slices(), laws, strict=True)]
    return lambda x: max(scale * magnitude(x[each]) for each, scale in scaled)


def apart_function(law: WeberLaw) -> Callable[[Vector, Vector], float]:
    """Return the function that gives the distance of a stimulus from an applied one in JNDs: the largest of a part.

    It is infinite for another stimulus where the JND is 0.
    """
    if not isinstance(law, PartsLaw):
        return lambda x, applied: _jnds_apart(law, x, applied)
    each_part = tuple(zip(law.slices(), law.laws, strict=True))
    return lambda x, applied: max(_jnds_apart(own, x[each], applied[each]) for each, own in each_part)


def _jnds_apart(law: WeberLaw, x: Vector, applied: Vector) -> float:
    jnd_n, away_n = law.jnd_n(magnitude(applied)), distance(x, applied)
    return away_n / jnd_n if jnd_n else (math.inf if away_n else 0.0)
