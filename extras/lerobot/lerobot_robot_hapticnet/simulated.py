"""A simulated robot to try the plug-in with: an arm in front of a wall, a spring that it turns, and a gripper."""

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from lerobot.robots import Robot, RobotConfig

if TYPE_CHECKING:
    from collections.abc import Callable

NAMES: Final = "x", "y", "z", "wx", "wy", "wz", "gripper"


@RobotConfig.register_subclass("hapticnet_simulated")
@dataclass(kw_only=True)
class HapticnetSimulatedConfig(RobotConfig):
    """Positions and opening are in millimetres, turns in radians."""

    wall_mm: float = 10.0
    wall_n_per_m: float = 600.0
    servo_n_per_m: float = 300.0
    spring_nm_per_rad: float = 0.3
    servo_nm_per_rad: float = 1.0
    object_mm: float = 30.0
    object_n_per_m: float = 600.0
    open_mm: float = 60.0
    lag_s: float = 0.02
    reports_force: bool = True


class HapticnetSimulated(Robot):
    """Elastic servos with a lag of first order each.

    Behind `wall_mm` a spring pushes x back; another turns wx, wy and wz back; the gripper holds an object.
    """

    config_class = HapticnetSimulatedConfig
    name = "hapticnet_simulated"

    def __init__(self, config: HapticnetSimulatedConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = {}
        self.clock: Callable[[], float] = time.monotonic
        self._goal = dict.fromkeys(NAMES, 0.0) | {"gripper": config.open_mm}
        self._at = dict(self._goal)
        self._then_s: float | None = None

    @property
    def observation_features(self) -> dict[str, Any]:
        """Positions [mm, rad], and forces [N] and torques [N·m] if it reports them."""
        return {**self.action_features, **(dict.fromkeys(self._felt(), float) if self.config.reports_force else {})}

    @property
    def action_features(self) -> dict[str, Any]:
        """Positions [mm, rad]."""
        return {f"{name}.pos": float for name in NAMES}

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
        """Set the goals [mm, rad]."""
        self._go_on()
        self._goal = {name: float(action.get(f"{name}.pos", at)) for name, at in self._goal.items()}
        return action

    def get_observation(self) -> dict[str, Any]:
        """Return where it is [mm, rad], and the forces [N] and torques [N·m] that push it back."""
        self._go_on()
        seen = {f"{name}.pos": at for name, at in self._at.items()}
        return {**seen, **self._felt()} if self.config.reports_force else seen

    def disconnect(self) -> None:
        """End."""
        self._then_s = None

    def _beyond(self, name: str, at: float) -> float:
        """Return how far a position is beyond that where it meets something; negative if it is so at smaller values."""
        if name == "x":
            return max(0.0, at - self.config.wall_mm)
        if name == "gripper":
            return min(0.0, at - self.config.object_mm)
        return at if name.startswith("w") else 0.0

    def _stiffness(self, name: str) -> tuple[float, float]:
        """Return the stiffness of what a position meets, and that of its servo [N/m, or N·m/rad]."""
        config = self.config
        if name.startswith("w"):
            return config.spring_nm_per_rad, config.servo_nm_per_rad
        return config.object_n_per_m if name == "gripper" else config.wall_n_per_m, config.servo_n_per_m

    def _felt(self) -> dict[str, float]:
        """Return forces and torques, positive if they push towards smaller values."""
        made = {}
        for name, at in self._at.items():
            pushes = self._stiffness(name)[0] * self._beyond(name, at)
            made.update({f"{name}.torque": pushes} if name.startswith("w") else {f"{name}.force": pushes / 1e3})
        return made

    def _go_on(self) -> None:
        if self._then_s is None:
            raise ConnectionError(f"{self} is not connected")
        now_s = self.clock()
        elapsed_s, self._then_s = now_s - self._then_s, now_s
        share = elapsed_s / (elapsed_s + self.config.lag_s) if self.config.lag_s else 1.0
        for name, goal in self._goal.items():
            meets, servo = self._stiffness(name)
            rest = goal - meets / (meets + servo) * self._beyond(name, goal)
            self._at[name] += share * (rest - self._at[name])
