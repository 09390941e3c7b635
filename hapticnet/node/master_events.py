"""What happens at a master, for whoever watches it."""

from dataclasses import dataclass
from typing import TypeAlias

from hapticnet.node.fingertip import FingertipEvent
from hapticnet.node.in_force import SettingsInForce
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.protocol.events import (
    ChangeRefused,
    Connected,
    Ended,
    Hinted,
    LinkRecovered,
    LinkStale,
    Noticed,
    Refused,
    SessionLost,
)


@dataclass(frozen=True, slots=True)
class Failed:
    """Operator, codec or device raised an exception: the force goes to zero and the session is closed."""

    reason: str


@dataclass(frozen=True, slots=True)
class Paused:
    """The operator raised an exception: the force goes to zero and the operator is not asked until `resume`."""

    reason: str


@dataclass(frozen=True, slots=True)
class Resumed:
    """The operator is asked again after `Paused`."""


NodeEvent: TypeAlias = (
    Connected
    | SettingsInForce
    | LinkStale
    | LinkRecovered
    | SessionLost
    | Refused
    | ChangeRefused
    | Hinted
    | Noticed
    | StepsTooSlow
    | Paused
    | Resumed
    | Failed
    | Ended
    | FingertipEvent
)
"""Events that a master reports; forces and confirmations stay inside."""
