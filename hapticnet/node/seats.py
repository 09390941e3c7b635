"""Who has a place at a slave, and who gives way when there are none left."""

from collections import Counter
from collections.abc import Collection, Hashable
from typing import Final

from hapticnet.errors import HapticnetError
from hapticnet.node.station import Station
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SlaveState

MOST_HALF_OPEN: Final = 128
"""Half-open sessions at once. They take no seat; this bounds their memory."""

MOST_HALF_OPEN_EACH: Final = 16
"""Half-open sessions of one identity at once."""


class NoSeatError(HapticnetError):
    """There is no place for another session of this identity."""


def who_gives_way(
    stations: Collection[Station], identity: Hashable, most: int, settings: SessionSettings, now_us: int
) -> Station | None:
    """Return the session that must end so that `identity` gets another one; None if there is a free place.

    A session whose master is silent gives way to another one of the same identity that holds all its places, or, when
    all places are taken, to an identity that holds fewer: first a session of the identity that holds most, and of these
    the one that has been silent for longest. So whoever takes many places cannot shut out the others.

    Parameters
    ----------
    most
        Places that this identity may hold.

    Raises
    ------
    NoSeatError
        If no session may be ended.
    """
    held = Counter(station.identity for station in stations if station.session.state is SlaveState.OPEN)
    silent = [
        station
        for station in stations
        if station.session.state is SlaveState.OPEN and station.session.silent_us(now_us) > settings.gives_way_us
    ]
    own = held[identity]
    if own >= most:
        candidates = [station for station in silent if station.identity == identity]
        reason = f"all {most} sessions that this master may have are taken"
    elif held.total() >= settings.most_sessions:
        candidates = [station for station in silent if held[station.identity] > own]
        reason = f"all {settings.most_sessions} sessions of this slave are taken"
    else:
        return None
    if not candidates:
        raise NoSeatError(reason)
    return max(candidates, key=lambda station: (held[station.identity], station.session.silent_us(now_us)))


def surplus_half_open(stations: Collection[Station], identity: Hashable) -> Station | None:
    """Return the half-open session that must end before another one of `identity` begins, or None."""
    waiting = [station for station in stations if station.session.state is SlaveState.HALF_OPEN]
    own = [station for station in waiting if station.identity == identity]
    if len(own) >= MOST_HALF_OPEN_EACH:
        return own[0]
    if len(waiting) >= MOST_HALF_OPEN:
        crowd, _ = Counter(station.identity for station in waiting).most_common(1)[0]
        return next(station for station in waiting if station.identity == crowd)
    return None


def to_continue(
    stations: Collection[Station], identity: Hashable, name: str, ticket: bytes | None, silent_us: int, now_us: int
) -> tuple[Station, bool] | None:
    """Return the session whose scene a new one goes on with, and whether its own master asks; None if there is none.

    That is the session of the ticket, or the one that the session of the ticket was to continue; without a ticket, one
    of the same identity and name. Another master than its own (one that was restarted) gets only the scene of a session
    that has been silent for longer than `silent_us`.
    """
    for station in stations:
        if station.identity != identity or station.session.state is not SlaveState.OPEN:
            continue
        if ticket is not None:
            is_own = station.is_own(ticket)
        else:
            is_own = False if station.session.request.name == name else None
        if is_own or (is_own is not None and station.session.silent_us(now_us) > silent_us):
            return station, is_own
    return None
