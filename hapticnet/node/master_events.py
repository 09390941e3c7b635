"""What happens at a master, for whoever watches it."""

from dataclasses import dataclass
from typing import TypeAlias

from hapticnet.node.fingertip import FingertipEvent
from hapticnet.protocol.events import (
    ChangeRefused,
    Connected,
    Ended,
    Hinted,
    LinkRecovered,
    LinkStale,
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


NodeEvent: TypeAlias = (
    Connected
    | LinkStale
    | LinkRecovered
    | SessionLost
    | Refused
    | ChangeRefused
    | Hinted
    | Paused
    | Failed
    | Ended
    | FingertipEvent
)
"""Events that a master reports; forces and confirmations stay inside."""
