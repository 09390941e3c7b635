"""The states of a session at either end and all transitions between them. docs/refer/protocol.md draws these tables."""

import enum
from collections.abc import Mapping
from typing import Final

from hapticnet.protocol.members import plain_members


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
    """What causes a transition."""

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
    CONTINUED = "a newer session of the same master goes on with the scene"


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

SLAVE_TRANSITIONS: Final[Mapping[tuple[SlaveState, Trigger], SlaveState]] = {
    (_S.HALF_OPEN, _T.POSITION): _S.OPEN,
    (_S.HALF_OPEN, _T.IDLE): _S.CLOSED,
    (_S.HALF_OPEN, _T.REPLACED): _S.CLOSED,
    (_S.HALF_OPEN, _T.PEER_CLOSED): _S.CLOSED,
    (_S.HALF_OPEN, _T.CLOSE): _S.CLOSED,
    (_S.OPEN, _T.IDLE): _S.CLOSED,
    (_S.OPEN, _T.REPLACED): _S.CLOSED,
    (_S.OPEN, _T.CONTINUED): _S.CLOSED,
    (_S.OPEN, _T.PEER_CLOSED): _S.CLOSED,
    (_S.OPEN, _T.CLOSE): _S.CLOSED,
}
