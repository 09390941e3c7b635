"""A simulated robot to try the plug-in with: position-controlled axes in front of a wall."""

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lerobot.robots import Robot, RobotConfig

from lerobot_robot_hapticnet.config import Joints

if TYPE_CHECKING:
    from collections.abc import Callable


@RobotConfig.register_subclass("hapticnet_simulated")
@dataclass(kw_only=True)
class HapticnetSimulatedConfig(RobotConfig, Joints):
    """Axes x, y, z (of `joints`); the first meets a wall. Units are millimetres."""

    wall_mm: float = 10.0
    wall_n_per_m: float = 600.0
    servo_n_per_m: float = 300.0
    lag_s: float = 0.02
    reports_force: bool = True


class HapticnetSimulated(Robot):
    """Elastic servos with a lag of first order each; behind `wall_mm` a spring pushes the first axis back."""

    config_class = HapticnetSimulatedConfig
    name = "hapticnet_simulated"

    def __init__(self, config: HapticnetSimulatedConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = {}
        self.clock: Callable[[], float] = time.monotonic
        self._goal = [0.0] * len(config.names)
        self._at = [0.0] * len(config.names)
        self._then_s: float | None = None

    @property
    def observation_features(self) -> dict[str, Any]:
        """Positions [mm], and forces [N] if it reports them."""
        forces = {f"{name}.force": float for name in self.config.names} if self.config.reports_force else {}
        return {**self.action_features, **forces}

    @property
    def action_features(self) -> dict[str, Any]:
        """Positions [mm]."""
        return {f"{name}.pos": float for name in self.config.names}

    @property
    def is_connected(self) -> bool:
        """Whether it is connected."""
        return self._then_s is not None

    @property
    def is_calibrated(self) -> bool:
        """It needs none."""
        return True

    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002 - the interface's
        """Begin."""
        self._then_s = self.clock()

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Set the goals [mm]."""
        self._go_on()
        self._goal = [
            float(action.get(f"{name}.pos", at)) for name, at in zip(self.config.names, self._goal, strict=True)
        ]
        return action

    def get_observation(self) -> dict[str, Any]:
        """Return where it is [mm], and the force [N] that pushes it back."""
        self._go_on()
        seen = {f"{name}.pos": at for name, at in zip(self.config.names, self._at, strict=True)}
        if self.config.reports_force:
            depth_m = max(0.0, self._at[0] - self.config.wall_mm) / 1e3
            forces = [self.config.wall_n_per_m * depth_m] + [0.0] * (len(self._at) - 1)
            seen |= {f"{name}.force": force for name, force in zip(self.config.names, forces, strict=True)}
        return seen

    def disconnect(self) -> None:
        """End."""
        self._then_s = None

    def rest_mm(self, goal_mm: float) -> float:
        """Return where the first axis comes to rest for a goal."""
        wall, servo = self.config.wall_n_per_m, self.config.servo_n_per_m
        return (
            goal_mm
            if goal_mm <= self.config.wall_mm
            else (servo * goal_mm + wall * self.config.wall_mm) / (servo + wall)
        )

    def _go_on(self) -> None:
        if self._then_s is None:
            raise ConnectionError(f"{self} is not connected")
        now_s = self.clock()
        elapsed_s, self._then_s = now_s - self._then_s, now_s
        share = elapsed_s / (elapsed_s + self.config.lag_s) if self.config.lag_s else 1.0
        rest = [self.rest_mm(self._goal[0]), *self._goal[1:]]
        self._at = [at + share * (to - at) for at, to in zip(self._at, rest, strict=True)]
