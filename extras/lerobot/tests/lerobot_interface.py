"""What the plug-in uses of LeRobot, written from its published interface, for machines without the 1.9 GB of it.

If LeRobot is installed, nothing here is used.
"""

import abc
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import ClassVar

REAL = find_spec("lerobot") is not None


class _Choices:
    @classmethod
    def register_subclass(cls, name):
        def register(kind):
            cls.known[name] = kind
            return kind

        return register

    @classmethod
    def get_known_choices(cls):
        return cls.known


@dataclass(kw_only=True)
class RobotConfig(_Choices):
    id: str | None = None
    calibration_dir: Path | None = None
    known: ClassVar = {}


@dataclass(kw_only=True)
class TeleoperatorConfig(_Choices):
    id: str | None = None
    calibration_dir: Path | None = None
    known: ClassVar = {}


class _Device:
    def __init__(self, config):
        self.id = config.id

    def __str__(self):
        return f"{self.id} {type(self).__name__}"


def _abstract(*names):
    return {name: abc.abstractmethod(lambda _self, *_: None) for name in names}


EVERY = "is_connected", "connect", "is_calibrated", "calibrate", "configure", "disconnect", "action_features"
Robot = type("Robot", (_Device, abc.ABC), _abstract(*EVERY, "observation_features", "get_observation", "send_action"))
Teleoperator = type(
    "Teleoperator", (_Device, abc.ABC), _abstract(*EVERY, "feedback_features", "get_action", "send_feedback")
)


class DeviceNotConnectedError(ConnectionError):
    pass


def make_robot_from_config(config):
    kind = type(config)
    return getattr(sys.modules[kind.__module__], kind.__name__.removesuffix("Config"))(config)


def install():
    contents = {
        "lerobot": {},
        "lerobot.robots": {
            "Robot": Robot, "RobotConfig": RobotConfig, "make_robot_from_config": make_robot_from_config
        },
        "lerobot.teleoperators": {"Teleoperator": Teleoperator, "TeleoperatorConfig": TeleoperatorConfig},
        "lerobot.utils": {},
        "lerobot.utils.errors": {"DeviceNotConnectedError": DeviceNotConnectedError},
    }  # fmt: skip
    for name, members in contents.items():
        sys.modules[name] = ModuleType(name)
        vars(sys.modules[name]).update(members)


if REAL:
    from lerobot.utils.errors import DeviceNotConnectedError
else:
    install()
