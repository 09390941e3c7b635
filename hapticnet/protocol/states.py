"""The states of a session at either end, all transitions between them, and the events of a master's session.

docs/refer/protocol.md draws the tables of transitions.
"""

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticnet.protocol.messages import Code, Grant
from hapticnet.protocol.wire import plain_members


@plain_members
class MasterState(enum.Enum):
    """State of the master's session."""

    CONNECTING = "connecting"
    ESTABLISHED = "established"
    STALE = "stale"
    CLOSING = "closing"
    CLOSED = "closed"


@plain_members
class SlaveState(enum.Enum):
    """State of one of the slave's sessions."""

    HALF_OPEN = "half open"
    OPEN = "open"
    CLOSED = "closed"


class Trigger(enum.Enum):
    """The cause of a transition."""

    WELCOMED = "WELCOME received"
    REFUSED = "refused, and there has never been a session"
    SILENCE = "nothing arrived for the age limit"
    HEARD = "a datagram of the session arrived"
    RESET = "RESET received while closing: the slave does not know the session"
    CLOSE = "our side closes"
    PEER_CLOSED = "CLOSE received"
    GAVE_UP = "no answer after the last try"
    POSITION = "first POSITION received"
    IDLE = "nothing arrived for the idle limit"
    REPLACED = "another master needed the place"
    CONTINUED = "a newer session of the same master continues the scene"


_M, _S, _T = MasterState, SlaveState, Trigger

MASTER_TRANSITIONS: Final[Mapping[tuple[MasterState, Trigger], MasterState]] = {
    (_M.CONNECTING, _T.WELCOMED): _M.ESTABLISHED,
    (_M.CONNECTING, _T.REFUSED): _M.CLOSED,
    (_M.CONNECTING, _T.CLOSE): _M.CLOSED,
    (_M.ESTABLISHED, _T.SILENCE): _M.STALE,
    (_M.ESTABLISHED, _T.WELCOMED): _M.ESTABLISHED,
    (_M.ESTABLISHED, _T.CLOSE): _M.CLOSING,
    (_M.ESTABLISHED, _T.PEER_CLOSED): _M.CONNECTING,
    (_M.STALE, _T.HEARD): _M.ESTABLISHED,
    (_M.STALE, _T.WELCOMED): _M.ESTABLISHED,
    (_M.STALE, _T.CLOSE): _M.CLOSING,
    (_M.STALE, _T.PEER_CLOSED): _M.CONNECTING,
    (_M.CLOSING, _T.PEER_CLOSED): _M.CLOSED,
    (_M.CLOSING, _T.RESET): _M.CLOSED,
    (_M.CLOSING, _T.GAVE_UP): _M.CLOSED,
}

_ENDS: Final = (_T.IDLE, _T.REPLACED, _T.PEER_CLOSED, _T.CLOSE)  # causes that close a session of the slave in any state

SLAVE_TRANSITIONS: Final[Mapping[tuple[SlaveState, Trigger], SlaveState]] = {
    (_S.HALF_OPEN, _T.POSITION): _S.OPEN,
    (_S.OPEN, _T.CONTINUED): _S.CLOSED,
    **{(state, trigger): _S.CLOSED for state in (_S.HALF_OPEN, _S.OPEN) for trigger in _ENDS},
}


@dataclass(frozen=True, slots=True)
class Connected:
    """A session is established, for the first time or after another one."""

    grant: Grant


@dataclass(frozen=True, slots=True)
class ForceArrived:
    """A force newer than the one applied. `is_parting`: of the previous session, until one of the new is applied."""

    sequence: int
    t_us: int
    payload: bytes
    is_parting: bool = False


@dataclass(frozen=True, slots=True)
class BoundArrived:
    """The slave's stiffness bound; precedes the other events of its datagram."""

    payload: bytes


@dataclass(frozen=True, slots=True)
class VibrationArrived:
    """A frame of vibration that begins at `t_us` [µs], and possibly the one before it."""

    t_us: int
    payload: bytes
    before: bytes | None


@dataclass(frozen=True, slots=True)
class HoldConfirmed:
    """Position `t_us` [µs] arrived, and nothing is newer than the applied force; `is_parting` as above."""

    t_us: int
    is_parting: bool = False


@dataclass(frozen=True, slots=True)
class LinkStale:
    """Nothing fresh arrived for the age limit.

    `too_old_us`: the smallest age [µs] of the answers that arrived too old to use; None if nothing
    arrived at all. If the first such answer arrives later, the event occurs a second time, with its age.
    """

    too_old_us: int | None = None


@dataclass(frozen=True, slots=True)
class LinkRecovered:
    """A fresh datagram of the session arrived while the link was stale."""


@dataclass(frozen=True, slots=True)
class SessionLost:
    """The slave ended the session; the master asks for a new one."""

    reason: str


@dataclass(frozen=True, slots=True)
class Refused:
    """No new session for a master that had one, or from a slave that stops; asked again after `retry_us`."""

    reason: str
    code: Code
    retry_us: int


@dataclass(frozen=True, slots=True)
class ChangeRefused:
    """The slave refused the session requested with `MasterSession.change`; the present one continues."""

    reason: str
    code: Code


@dataclass(frozen=True, slots=True)
class Hinted:
    """An unauthenticated answer says that the slave refuses the session. The master keeps asking."""

    reason: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The session is over. `refused`: it never began; `reason` and `code` are then the slave's."""

    reason: str
    refused: bool
    code: Code = Code.OTHER


@dataclass(frozen=True, slots=True)
class Noticed:
    """A notice from the slave about the continuing session; once for each `code`, or with shapes of the scene."""

    reason: str
    code: Code
    shapes: bytes | None = None


MasterEvent: TypeAlias = (
    Connected
    | ForceArrived
    | BoundArrived
    | HoldConfirmed
    | VibrationArrived
    | LinkStale
    | LinkRecovered
    | SessionLost
    | Refused
    | ChangeRefused
    | Hinted
    | Noticed
    | Ended
)
