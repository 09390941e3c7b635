"""What happens in a master's session, for the node that owns it."""

from dataclasses import dataclass
from typing import TypeAlias

from hapticnet.protocol.messages import Code, Grant


@dataclass(frozen=True, slots=True)
class Connected:
    """A session is established, for the first time or after another one."""

    grant: Grant


@dataclass(frozen=True, slots=True)
class ForceArrived:
    """A force newer than the one applied; `MasterSession.applied` once it is decoded and held.

    `is_parting`: it comes from the session before, which goes on until a force of the new one is applied.
    """

    sequence: int
    t_us: int
    payload: bytes
    is_parting: bool = False


@dataclass(frozen=True, slots=True)
class BoundArrived:
    """The slave tells how the force may change near the tool; comes before what else the datagram says."""

    payload: bytes


@dataclass(frozen=True, slots=True)
class HoldConfirmed:
    """The slave received the position of time `t_us` and has sent nothing newer than the force applied.

    `is_parting`: as of `ForceArrived`.
    """

    t_us: int
    is_parting: bool = False


@dataclass(frozen=True, slots=True)
class LinkStale:
    """Nothing fresh arrived for the age limit.

    `too_old_us`: the age [µs] of the least old answer among those that arrived too old to be used; None if nothing
    arrived at all. If the first such answer arrives later, the event comes a second time, with its age.
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
    """The slave refused a new session to a master that had one, or because it is about to stop.

    The master asks again after `retry_us` [µs].
    """

    reason: str
    code: Code
    retry_us: int


@dataclass(frozen=True, slots=True)
class ChangeRefused:
    """The slave refused the other session that was asked for with `MasterSession.change`; the present one goes on."""

    reason: str
    code: Code


@dataclass(frozen=True, slots=True)
class Hinted:
    """An unauthenticated answer says that the slave refuses the session. The master goes on asking."""

    reason: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The session is over. `refused`: it never began; `reason` and `code` are then the slave's."""

    reason: str
    refused: bool
    code: Code = Code.OTHER


@dataclass(frozen=True, slots=True)
class Noticed:
    """The slave tells something about the session, which goes on; once for each `code` of a session."""

    reason: str
    code: Code


MasterEvent: TypeAlias = (
    Connected
    | ForceArrived
    | BoundArrived
    | HoldConfirmed
    | LinkStale
    | LinkRecovered
    | SessionLost
    | Refused
    | ChangeRefused
    | Hinted
    | Noticed
    | Ended
)
