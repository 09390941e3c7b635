"""What the hand touches in the sessions of the suite."""

import math
from typing import Final

import numpy as np

from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.ahead import LayerAhead
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.stiffness_bound import StiffnessBound

BEGINS_M, STIFFNESS_N_PER_M, DAMPING_N_S_PER_M, FAR_M = 0.01, 300.0, 2.0, 1e3


class Hand:
    """A hand that goes in and out, not the same on each axis; it remembers where it is."""

    duration_us = None

    def __init__(self, axes: int) -> None:
        self.axes = axes
        self.position_m = (0.0,) * axes

    def sample(self, t_us: int) -> tuple[float, ...]:
        self.position_m = tuple(0.02 * (1.0 - math.cos(t_us / 2e5 * (1 + i))) + 1e-4 * i for i in range(self.axes))
        return self.position_m


class Spring:
    """A spring behind a place, on each axis."""

    def __init__(self, axes: int) -> None:
        self.axes, self.name = axes, f"{axes} springs"

    def step(self, sample: PositionSample) -> ForceSample:
        force_n = (STIFFNESS_N_PER_M * max(0.0, x - BEGINS_M) for x in sample.position_m)
        return ForceSample(sample.t_us, tuple(force_n))


class Soft(Spring):
    """The springs with dampers. It tells the layers ahead and how stiff it is here, and can be copied."""

    def __init__(self, axes: int) -> None:
        super().__init__(axes)
        self.t_us: int | None = None
        self.place_m: tuple[float, ...] = (0.0,) * axes

    def step(self, sample: PositionSample) -> ForceSample:
        elapsed_s = 0.0 if self.t_us is None else 1e-6 * (sample.t_us - self.t_us)
        moved_m = [x - was for x, was in zip(sample.position_m, self.place_m, strict=True)]
        self.t_us, self.place_m = sample.t_us, sample.position_m
        force_n = [0.0] * self.axes
        for i, x in enumerate(self.place_m):
            if x > BEGINS_M:
                speed = moved_m[i] / elapsed_s if elapsed_s > 0.0 else 0.0
                force_n[i] = max(0.0, STIFFNESS_N_PER_M * (x - BEGINS_M) + DAMPING_N_S_PER_M * speed)
        return ForceSample(sample.t_us, tuple(force_n))

    def stiffness_bound(self) -> StiffnessBound:
        inside = [x > BEGINS_M for x in self.place_m]
        low_m = tuple(BEGINS_M if each else -FAR_M for each in inside)
        high_m = tuple(FAR_M if each else BEGINS_M for each in inside)
        return StiffnessBound(STIFFNESS_N_PER_M * any(inside), DAMPING_N_S_PER_M * any(inside), low_m, high_m)

    def ahead(self) -> list[LayerAhead]:
        normals = np.eye(self.axes).tolist()
        return [
            LayerAhead(BEGINS_M, STIFFNESS_N_PER_M, viscosity_n_s_per_m=DAMPING_N_S_PER_M, normal=tuple(each))
            for each in normals
        ]

    def copy(self) -> "Soft":
        made = type(self)(self.axes)
        made.t_us, made.place_m = self.t_us, self.place_m
        return made


TISSUES: Final[dict[str, dict[str, float]]] = {
    "plain": {},
    "viscous": {"viscosity_n_s_per_m": 3.0},
    "stiffening": {"stiffening_per_m": 80.0, "viscosity_n_s_per_m": 1.0},
    "rubbing": {"shaft_friction_n": 0.4},
    "recovering": {"recovery_time_s": 0.2},
}


def tissue(kind: str, count: int = 2) -> Scene:
    """Return tissues that break, one behind the other."""
    places_m = [0.012 + 0.014 * i / (count - 1) for i in range(count)]
    properties = {"stiffness_n_per_m": 500.0 / count, "breach_force_n": 1.5, **TISSUES[kind]}
    return Scene([Tissue(name=f"{x_m:g}", rest_position_m=x_m, **properties) for x_m in places_m])
