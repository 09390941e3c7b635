"""A hand that yields: an arm or a finger that holds a grounded device, moved by its intention and by the force.

A scripted motion goes on whatever force comes back. A hand with mass M, damping B and stiffness K about the motion it
intends gives way to the force F that the device applies:

    (M + m) x'' + B (x' − i') + b x' + K (x − i) = −F + f + r

with the intended motion i, the device's mass m, damping b and Coulomb friction f, and the stretch reflex r, which is
late. F is positive when it pushes the hand out of the tissue, and constant from tick to tick, as a device holds it; the
solution from tick to tick is therefore exact for every mass, stiffness and rate. Friction is the force, up to its
limit, that stops the hand within the tick.
"""

import dataclasses
import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from hapticnet.capabilities import Capabilities
from hapticnet.checks import check_integer, check_parameter, meant
from hapticnet.errors import SettingsError
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import scripted_hand
from hapticnet.oscillator import exact_step
from hapticnet.samples import PositionSample, Vector, new_tuple

LONGEST_STEP_US: Final = 20_000
"""Longest time [µs] by which one sample moves the hand; after a pause it goes on from its last position."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandSettings:
    """Mechanics of a hand about the motion that it intends, the same on every axis."""

    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    # Stretch reflex: a stiffness about the intended motion that acts `reflex_delay_s` late. 25 to 50 ms are usual for
    # spinal reflexes of the arm; an assumption.
    reflex_n_per_m: float = 0.0
    reflex_delay_s: float = 0.04

    def __post_init__(self) -> None:
        check_parameter("mass of the hand", self.mass_kg, 1e-6, 100.0, "kg")
        check_parameter("damping of the hand", self.damping_n_s_per_m, 0.0, 1e4, "N·s/m")
        check_parameter("stiffness of the hand", self.stiffness_n_per_m, 1.0, 1e6, "N/m")
        check_parameter("stiffness of the reflex", self.reflex_n_per_m, 0.0, 1e5, "N/m")
        check_parameter("delay of the reflex", self.reflex_delay_s, 0.001, 1.0, "s")


HANDS: Final = {
    # One trial of one participant: van Beek et al., "Haptic perception of force magnitude and its relation to postural
    # arm dynamics in 3D", Scientific Reports 5:18004 (2015), figure 3.
    "arm": HandSettings(mass_kg=0.554, damping_n_s_per_m=6.45, stiffness_n_per_m=135.0),
    # Assumptions: the arm tensed, the arm slack, and a finger on the stage of a small device.
    "stiff-arm": HandSettings(mass_kg=0.7, damping_n_s_per_m=20.0, stiffness_n_per_m=500.0),
    "tired-arm": HandSettings(
        mass_kg=1.0, damping_n_s_per_m=4.0, stiffness_n_per_m=60.0, reflex_n_per_m=20.0, reflex_delay_s=0.06
    ),
    "finger": HandSettings(mass_kg=0.05, damping_n_s_per_m=2.0, stiffness_n_per_m=300.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundedSettings:
    """A grounded (kinesthetic) device: what the hand feels of it, and what it can render."""

    mass_kg: float = 0.0
    damping_n_s_per_m: float = 0.0
    friction_n: float = 0.0
    max_force_n: float = math.inf
    rate_hz: float = math.inf  # how often it takes a new force; faster than the ticks: with each
    resolution_m: float = 0.0  # step of its position sensor; 0: none

    def __post_init__(self) -> None:
        check_parameter("mass of the device", self.mass_kg, 0.0, 100.0, "kg")
        check_parameter("damping of the device", self.damping_n_s_per_m, 0.0, 1e4, "N·s/m")
        check_parameter("friction of the device", self.friction_n, 0.0, 100.0, "N")
        check_parameter("resolution of the device", self.resolution_m, 0.0, 0.01, "m")
        if self.max_force_n != math.inf:
            check_parameter("largest force of the device", self.max_force_n, 1e-3, 1e4, "N")
        if self.rate_hz != math.inf:
            check_parameter("rate of the device", self.rate_hz, 20.0, 1e5, "Hz")

    def capabilities(self, axes: int) -> Capabilities:
        """Return what the device can do on so many axes."""
        return Capabilities(axes=axes, max_force_n=self.max_force_n, rate_hz=self.rate_hz, grounded=True)


HAND_KEYS: Final = {
    "mass": "mass_kg",
    "damping": "damping_n_s_per_m",
    "stiffness": "stiffness_n_per_m",
    "reflex": "reflex_n_per_m",
    "reflex-delay": "reflex_delay_s",
}
DEVICE_KEYS: Final = {
    "device-mass": "mass_kg",
    "device-damping": "damping_n_s_per_m",
    "friction": "friction_n",
    "max-force": "max_force_n",
    "rate": "rate_hz",
    "resolution": "resolution_m",
}
KEYS: Final = (*HAND_KEYS, *DEVICE_KEYS, "axes", "motion")
"""What the text of a hand may give, in SI units: the hand, its device, its axes, and last of all what it intends."""


class HandSpec(NamedTuple):
    """A hand that yields, as its text describes it."""

    hand: HandSettings
    device: GroundedSettings
    axes: int | None  # None: those of the scene, or of the motion
    motion: str  # the text of another operator; empty: the scripted motion

    def holding(self, intended: Operator) -> "YieldingOperator":
        """Return the hand that intends this motion."""
        return YieldingOperator(intended, self.hand, self.device)


def is_hand(text: str) -> bool:
    """Return whether the text of an operator names a hand that yields."""
    return text.partition(":")[0] == "hand"


def parse_hand(text: str) -> HandSpec:
    """Return the hand written as ``hand:NAME[,KEY=VALUE…][,motion=OPERATOR]``; see `HANDS` and `KEYS`.

    Raise SettingsError if there is no such hand or key, or a value is invalid.
    """
    given, _, motion = text.partition(":")[2].partition(",motion=")
    name, *parts = (each.strip() for each in given.split(","))
    if name not in HANDS:
        raise SettingsError(f"unknown hand {name!r}{meant(name, HANDS)}; there are: {', '.join(HANDS)}")
    values: dict[str, float] = {}
    for part in parts:
        key, _, value = (each.strip() for each in part.partition("="))
        if key not in KEYS:
            raise SettingsError(f"hand {name!r} has no {key!r}{meant(key, KEYS)}; there are: {', '.join(KEYS)}")
        try:
            if key in values:
                raise ValueError
            values[key] = float(value)
        except ValueError:
            raise SettingsError(f"hand {name!r}: {part!r} must be KEY=NUMBER, each key once, as in mass=0.5") from None
    axes = values.get("axes")
    if axes is not None:
        check_integer("axes of the hand", axes, 1, 3)
    hand = dataclasses.replace(HANDS[name], **{HAND_KEYS[key]: values[key] for key in values if key in HAND_KEYS})
    device = GroundedSettings(**{DEVICE_KEYS[key]: values[key] for key in values if key in DEVICE_KEYS})
    return HandSpec(hand, device, None if axes is None else int(axes), motion.strip())


def scripted_yielding(text: str, axes: int, times: int, rng: np.random.Generator) -> "YieldingOperator":
    """Return the hand of a text on so many axes; it intends the default motion, so many times. SettingsError if not."""
    spec = parse_hand(text)
    if spec.motion or spec.axes not in (None, axes):
        raise SettingsError(f"operator {text!r}: omit axes and motion, which the scene gives, or pass an object")
    return spec.holding(scripted_hand(axes, times, rng))


class YieldingOperator:
    """A hand on a grounded device. Satisfies `Operator`, with `feel`.

    `intended`: the motion that the hand would make without a force.
    """

    def __init__(self, intended: Operator, hand: HandSettings, device: GroundedSettings | None = None) -> None:
        self.what = "the hand that yields"
        self.axes = intended.axes
        self.duration_us = intended.duration_us
        self.intended, self.hand, self.device = intended, hand, device or GroundedSettings()
        self.capabilities = self.device.capabilities(self.axes)
        self.applied_n: Vector = (0.0,) * self.axes  # force [N] of the device on the hand now
        self._taken_us: int | None = None
        self._period_us = 1e6 / self.device.rate_hz
        self._now_us: int | None = None
        self._intended_m: Vector = ()
        self._offset_m: list[float] = []  # of the hand from the intended motion, and its rate
        self._rate_m_per_s: list[float] = []
        self._past: deque[tuple[int, tuple[float, ...]]] = deque()  # offsets that the reflex has not answered yet
        self._step_us = 0
        self._step = exact_step(1.0, 1.0, 1.0, 1.0)

    def feel(self, t_us: int, force_n: Vector) -> None:
        """Apply a force [N] until the next one, if the device takes one now, at most its largest."""
        if self._taken_us is not None and 0 <= t_us - self._taken_us < self._period_us - 0.5:
            return
        self._taken_us = t_us
        size_n = math.hypot(*force_n)
        share = self.device.max_force_n / size_n if size_n > self.device.max_force_n else 1.0
        self.applied_n = tuple([component * share for component in force_n])

    def sample(self, t_us: int) -> PositionSample:
        """Return the position that the device measures at `t_us` [µs] from the start of the motion."""
        intended_m = self.intended.sample(t_us).position_m
        before_us, self._now_us = self._now_us, t_us
        if before_us is None:
            self._offset_m, self._rate_m_per_s = [0.0] * self.axes, [0.0] * self.axes
        elif t_us > before_us:
            self._move(min(t_us - before_us, LONGEST_STEP_US), intended_m, t_us)
        self._intended_m = intended_m
        position_m = [at + offset for at, offset in zip(intended_m, self._offset_m, strict=True)]
        if self.device.resolution_m:
            position_m = [self.device.resolution_m * round(at / self.device.resolution_m) for at in position_m]
        return new_tuple(PositionSample, (t_us, tuple(position_m)))

    def _move(self, step_us: int, intended_m: Vector, t_us: int) -> None:
        """Move the hand over a time in which force, reflex and intended velocity are constant."""
        hand, device = self.hand, self.device
        if step_us != self._step_us:
            mass_kg, damping = hand.mass_kg + device.mass_kg, hand.damping_n_s_per_m + device.damping_n_s_per_m
            self._step = exact_step(mass_kg, damping, hand.stiffness_n_per_m, 1e-6 * step_us)
            self._step_us = step_us
        reflex_m = self._stretch(t_us) if hand.reflex_n_per_m else None
        xx, xv, xf, vx, vv, vf = self._step
        for axis in range(self.axes):
            x, v = self._offset_m[axis], self._rate_m_per_s[axis]
            intended_m_per_s = (intended_m[axis] - self._intended_m[axis]) * 1e6 / step_us
            force_n = -self.applied_n[axis] - device.damping_n_s_per_m * intended_m_per_s
            if reflex_m is not None:
                force_n -= hand.reflex_n_per_m * reflex_m[axis]
            after = vx * x + vv * v + vf * force_n
            if device.friction_n:
                stops_n = -(after + intended_m_per_s) / vf
                force_n += min(max(stops_n, -device.friction_n), device.friction_n)
                after = vx * x + vv * v + vf * force_n
            self._offset_m[axis] = xx * x + xv * v + xf * force_n
            self._rate_m_per_s[axis] = after

    def _stretch(self, t_us: int) -> tuple[float, ...]:
        """Return the offset [m] that the reflex answers now; note the present one."""
        past, delay_us = self._past, 1e6 * self.hand.reflex_delay_s
        past.append((t_us, tuple(self._offset_m)))
        while len(past) > 1 and past[1][0] <= t_us - delay_us:
            past.popleft()
        return past[0][1] if past[0][0] <= t_us - delay_us else (0.0,) * self.axes
