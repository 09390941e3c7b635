"""A follower: a mass that a PD or PID controller moves to the received position, and that touches the scene.

    M x'' = K (i − x) + B (i' − x') + J ∫(i − x) dt − F(x)

with the received position i, which moves evenly from one sample to the next, and the contact force F of the scene. A
step solves the motion without contact exactly. The contact force is constant during a step and is that of its end,
which is found on copies of the scene. So whatever the step, mass and stiffness are, a force that grows with depth takes
at least as much energy from the mass as the scene stores: F (x₁ − x₀) ≥ V(x₁) − V(x₀).
"""

from dataclasses import replace
from typing import Final, TypeAlias

from hapticnet.checks import axes_of
from hapticnet.errors import SampleError
from hapticnet.oscillator import exact_step
from hapticnet.samples import ForceSample, PositionSample, Vector, checked_vector
from hapticnet.scene.base import breaches_of
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import AnySceneSettings, FollowerSettings
from hapticnet.vectors import distance, dot, magnitude, minus, plus, times

LONGEST_STEP_US: Final = 500  # it damps a contact of 800 N/m by 0.2 N·s/m
LONGEST_MOTION_US: Final = 100_000  # after a longer pause the mass moves for this time only
MOST_TRIES: Final = 60
HALVINGS: Final = 30  # to find where a surface breaks
SMALLEST_SHARE: Final = 1e-6  # to which the contact force is found, and [N]

Contact: TypeAlias = Scene | BodyScene


class Follower:
    """A scene of which a follower touches the surfaces. Satisfies `Touchable`.

    It has neither `ahead` nor `stiffness_bound`: they would be for the follower's position, which no master knows.
    """

    def __init__(self, scene: Contact, settings: FollowerSettings) -> None:
        self.name = scene.name
        self.axes = scene.axes
        self._of = settings
        self._scene = scene  # never stepped, but replaced by a copy that was, so that followers may share it
        self._t_us = 0
        self._received_m: Vector | None = None
        self._received_m_per_s: Vector = (0.0,) * self.axes
        self.position_m: Vector = (0.0,) * self.axes  # of the mass, and its velocity
        self.velocity_m_per_s: Vector = (0.0,) * self.axes
        self._integral_n: Vector = (0.0,) * self.axes
        self._contact_n: Vector = (0.0,) * self.axes
        self._stiffness = scene.settings.stiffest_n_per_m  # of the newest contact [N/m], a first guess

    @property
    def settings(self) -> AnySceneSettings:
        """Settings of the scene and of its follower."""
        return replace(self._scene.settings, follower=self._of)

    @property
    def breaches(self) -> int:
        """Surfaces breached so far."""
        return breaches_of(self._scene)

    def copy(self) -> "Follower":
        """Return a follower in the same state."""
        other = Follower(self._scene, self._of)
        other._t_us, other._received_m = self._t_us, self._received_m
        other._received_m_per_s, other.velocity_m_per_s = self._received_m_per_s, self.velocity_m_per_s
        other.position_m = self.position_m
        other._integral_n, other._contact_n, other._stiffness = self._integral_n, self._contact_n, self._stiffness
        return other

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the contact's or the controller's force [N]; SampleError if the position is unusable."""
        wanted_m = checked_vector(sample.position_m, "position")
        if len(wanted_m) != self.axes:
            raise SampleError(f"position has {axes_of(len(wanted_m))}; the scene has {self.axes}")
        if self._received_m is None:
            self.position_m = wanted_m
            self._scene, self._contact_n = self._try(sample.t_us, wanted_m)
        elif sample.t_us > self._t_us:
            elapsed_us = sample.t_us - self._t_us
            self._received_m_per_s = times(minus(wanted_m, self._received_m), 1e6 / elapsed_us)
            moving_us = min(elapsed_us, LONGEST_MOTION_US)
            steps = -(-moving_us // LONGEST_STEP_US)
            for step in range(steps):
                left_us = moving_us - moving_us * (step + 1) // steps
                self._move(sample.t_us - left_us, 1e-6 * moving_us / steps, wanted_m, 1e-6 * left_us)
        self._received_m, self._t_us = wanted_m, sample.t_us
        if self._of.force == "contact":
            return ForceSample(sample.t_us, self._contact_n)
        spring_n = times(minus(wanted_m, self.position_m), self._of.stiffness_n_per_m)
        slower = minus(self._received_m_per_s, self.velocity_m_per_s)
        damper_n = times(slower, self._of.damping_n_s_per_m)
        return ForceSample(sample.t_us, plus(plus(spring_n, damper_n), self._integral_n))

    def _move(self, t_us: int, step_s: float, wanted_m: Vector, left_s: float) -> None:
        """Move the mass for `step_s` until `t_us`, `left_s` before it is asked to be at `wanted_m`."""
        of = self._of
        xx, xv, xf, vx, vv, vf = exact_step(of.mass_kg, of.damping_n_s_per_m, of.stiffness_n_per_m, step_s)
        speed = self._received_m_per_s
        to_m = minus(wanted_m, times(speed, left_s))
        off_m = minus(self.position_m, minus(to_m, times(speed, step_s)))
        slip = minus(self.velocity_m_per_s, speed)
        pushed = self._integral_n
        free_m = plus(to_m, plus(plus(times(off_m, xx), times(slip, xv)), times(pushed, xf)))
        self._touch(t_us, free_m, xf)
        force_n = minus(pushed, self._contact_n)
        self.velocity_m_per_s = plus(speed, plus(plus(times(off_m, vx), times(slip, vv)), times(force_n, vf)))
        if of.integral_n_per_m_s:
            middle_m = times(plus(off_m, minus(self.position_m, to_m)), 0.5)
            self._integral_n = minus(pushed, times(middle_m, of.integral_n_per_m_s * step_s))

    def _try(self, t_us: int, at_m: Vector) -> tuple[Contact, Vector]:
        """Return a copy of the scene, touched there, and its force [N]."""
        scene = self._scene.copy()
        return scene, scene.step(PositionSample(t_us, at_m)).force_n

    def _touch(self, t_us: int, free_m: Vector, give: float) -> None:
        """Move the mass to `free_m`, less `give` [m/N] times the force of its contact there."""
        at_m = free_m
        scene, force_n = self._try(t_us, at_m)
        while breaches_of(scene) > self.breaches:
            at_m, force_n, broken_m, broken = self._breach(t_us, free_m, scene)
            if give * magnitude(force_n) >= distance(free_m, at_m):
                break  # the contact holds the mass before anything breaks
            self._scene, self.position_m, at_m = broken, broken_m, free_m
            scene, force_n = self._try(t_us, at_m)
        size_n, near_m = magnitude(force_n), distance(free_m, at_m)
        if size_n > 0.0:
            # Find how far the contact pushes the mass back: regula falsi, of the kind Illinois, from a spring's answer.
            way = times(force_n, 1.0 / size_n)
            far_m = most_m = give * size_n
            near, far, before = near_m - most_m, most_m, 0
            back_m = (most_m + give * self._stiffness * near_m) / (1.0 + give * self._stiffness)
            first_m = near_m
            for _ in range(MOST_TRIES):
                at_m = minus(free_m, times(way, back_m))
                scene, force_n = self._try(t_us, at_m)
                miss = back_m - give * dot(force_n, way)
                if abs(miss) <= give * SMALLEST_SHARE * (1.0 + size_n):
                    break
                if miss < 0.0:
                    near_m, near, far, before = back_m, miss, 0.5 * far if before < 0 else far, -1
                else:
                    far_m, far, near, before = back_m, miss, 0.5 * near if before > 0 else near, 1
                back_m = near_m + (far_m - near_m) * near / (near - far)
            if back_m > first_m:
                self._stiffness = max(0.0, (size_n - dot(force_n, way)) / (back_m - first_m))
        self._scene, self.position_m, self._contact_n = scene, at_m, force_n

    def _breach(self, t_us: int, free_m: Vector, scene: Contact) -> tuple[Vector, Vector, Vector, Contact]:
        """Return the last position and force [N] before the next breach on the way to `free_m`, and where it breaks."""
        whole_m, force_n, broken_m, broken = self.position_m, (0.0,) * self.axes, free_m, scene
        for _ in range(HALVINGS):
            middle_m = times(plus(whole_m, broken_m), 0.5)
            scene, tried_n = self._try(t_us, middle_m)
            if breaches_of(scene) > self.breaches:
                broken_m, broken = middle_m, scene
            else:
                whole_m, force_n = middle_m, tried_n
        return whole_m, force_n, broken_m, broken
