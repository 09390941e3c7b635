"""`slave_session.SlaveSession` over a row of numbers: compiled for the bank (docs/adr/0013).

Arrivals, the granted rate, counts and acknowledgements do what `ArrivalWindow`, `TokenBucket`, `Traffic` and
`SlaveSession` do with a POSITION of an open session. What happens rarely is left to these: `sort` then says UNUSUAL,
and nothing has changed.
"""

from typing import Any, Final

import numpy as np

from hapticnet.protocol.arrivals import LEAP, MISORDER, WINDOW, ArrivalWindow
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.frames import NONE
from hapticnet.protocol.repair_steps import REPAIR_FIELDS, acknowledged, repair_from_row, repair_to_row
from hapticnet.protocol.serial_number import distance, unwrap, wrap
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.wire import Kind

NEW, LATE, DUPLICATE, UNUSUAL = range(4)

SESSION_FIELDS: Final[list[Any]] = [
    *REPAIR_FIELDS,
    ("number", np.int64),
    ("version", np.int64),
    ("sequence", np.int64),
    ("newest_force", np.int64),  # NONE: none yet
    ("told_since", np.int64),  # NONE: the outlook was not sent yet
    ("telling", np.bool_),  # whether the master must be told the outlook
    ("in_step", np.bool_),
    ("position_t_us", np.int64),
    ("heard_us", np.int64),
    # arrivals
    ("authentic", np.bool_),
    ("window_newest", np.int64),
    ("expected", np.int64),
    ("unique", np.int64),
    ("after_leap", np.int64),  # NONE: none
    ("behind", np.int64),
    ("behind_run", np.int64),
    ("seen", np.uint8, (WINDOW,)),  # 1: has arrived; by sequence number modulo WINDOW
    # granted rate
    ("token_us", np.float64),
    ("empty_us", np.float64),
    ("full_us", np.float64),
    # counts
    ("received_packets", np.int64),
    ("received_bytes", np.int64),
    ("positions", np.int64),
    ("late", np.int64),
    ("duplicate", np.int64),
    ("malformed", np.int64),
    ("over_rate", np.int64),
    ("sent_packets", np.int64),
    ("sent_bytes", np.int64),
    ("forces", np.int64),
    ("keepalives", np.int64),
]


def sort(row: Any, sequence: int) -> int:
    """Return the kind of an arrival; see `ArrivalWindow.arrive`. Nothing changes."""
    ahead = distance(sequence, row.window_newest)
    if ahead > 0:
        return NEW if row.authentic or ahead < LEAP else UNUSUAL
    if ahead < -MISORDER and not row.authentic:
        return UNUSUAL
    if ahead <= -WINDOW:
        return LATE
    return DUPLICATE if row.seen[sequence % WINDOW] else LATE


def arrived(row: Any, sequence: int, arrival: int) -> None:
    """Record an arrival that `sort` has sorted."""
    ahead = distance(sequence, row.window_newest)
    if arrival == NEW:
        if ahead >= WINDOW:
            row.seen[:] = 0
        else:
            for skipped in range(1, ahead):
                row.seen[(row.window_newest + skipped) % WINDOW] = 0
        row.seen[sequence % WINDOW] = 1
        row.after_leap = NONE
        row.behind_run = 0
        row.window_newest = sequence
        row.expected += ahead
        row.unique += 1
    elif arrival == DUPLICATE:
        row.duplicate += 1
    else:
        row.late += 1
        if ahead > -WINDOW:
            row.seen[sequence % WINDOW] = 1
            if row.expected > row.unique:
                row.unique += 1


def take_token(row: Any, now_us: int) -> bool:
    """See `TokenBucket.take`."""
    full_us = (row.full_us if row.full_us > now_us else now_us) + row.token_us
    if full_us - now_us > row.empty_us:
        if full_us - now_us > row.empty_us + row.token_us + 1.0:
            row.full_us = now_us + row.empty_us
        return False
    row.full_us = full_us
    return True


def hear(row: Any, t_us: int, newest: int, now_us: int) -> int:
    """Take in a new position and its acknowledgement; return its time stamp, unwrapped."""
    row.heard_us = min(row.heard_us, now_us)
    clock_us = row.position_t_us + now_us - row.heard_us
    row.heard_us = now_us
    row.in_step = False
    if newest != NONE:
        since = row.told_since
        if since != NONE and distance(newest, since) >= 0 and distance(row.sequence, newest) > 0:
            row.telling, row.told_since = False, NONE
        acknowledged(row, newest, now_us)
        row.in_step = row.newest_force != NONE and distance(newest, row.newest_force) >= 0
    row.position_t_us = unwrap(t_us, clock_us)
    return int(row.position_t_us)


def count_received(row: Any, size: int) -> None:
    """Count a POSITION."""
    row.received_packets += 1
    row.received_bytes += size
    row.positions += 1


def count_malformed(row: Any, size: int) -> None:
    """Count a datagram that does not open."""
    row.received_packets += 1
    row.received_bytes += size
    row.malformed += 1


def count_sent(row: Any, size: int, now_us: int, is_force: bool) -> None:
    """Count a FORCE or KEEPALIVE that is ready to be sent, and go on to the next number."""
    if row.telling and row.told_since == NONE:
        row.told_since = row.sequence
    row.sequence = wrap(row.sequence + 1)
    row.spoke_us = now_us
    row.sent_packets += 1
    row.sent_bytes += size
    if is_force:
        row.forces += 1
    else:
        row.keepalives += 1


def session_to_row(session: SlaveSession, row: Any) -> None:
    """Copy an open session to a row. What it must tell its master is not copied: the course knows it."""
    row.number, row.version, row.sequence = session.number, session.version, session._sequence
    row.newest_force = NONE if session._newest_force is None else session._newest_force
    row.told_since = NONE if session._told_since is None else session._told_since
    row.telling = session._outlook is not None
    row.in_step = session.in_step
    row.position_t_us, row.heard_us = session._position_t_us, session._heard_us
    repair_to_row(session._repair, row)
    window = session.received.window
    assert window is not None, "the session is open"  # noqa: S101 - for the type checker
    _window_to_row(window, row)
    bucket = session._policed
    row.token_us, row.empty_us, row.full_us = bucket._each_us, bucket._empty_us, bucket._full_us
    received, sent = session.received, session.sent
    row.received_packets, row.received_bytes = received.packets, received.payload_bytes
    row.positions, row.late, row.duplicate = received.by_kind[Kind.POSITION], received.late, received.duplicate
    row.malformed, row.over_rate = received.malformed, received.over_rate
    row.sent_packets, row.sent_bytes = sent.packets, sent.payload_bytes
    row.forces, row.keepalives = sent.by_kind[Kind.FORCE], sent.by_kind[Kind.KEEPALIVE]


def session_from_row(session: SlaveSession, row: Any, outlook: bytes | None) -> None:
    """Copy a row back to its session, without the counts; `outlook` is what the master must be told."""
    session._sequence = int(row.sequence)
    session._newest_force = None if row.newest_force == NONE else int(row.newest_force)
    session._told_since = None if row.told_since == NONE else int(row.told_since)
    session._outlook = outlook if row.telling else None
    session.in_step = bool(row.in_step)
    session._position_t_us, session._heard_us = int(row.position_t_us), int(row.heard_us)
    repair_from_row(session._repair, row)
    assert session.received.window is not None, "the session is open"  # noqa: S101 - for the type checker
    _window_from_row(session.received.window, row)
    _bucket_from_row(session._policed, row)


def _window_to_row(window: ArrivalWindow, row: Any) -> None:
    row.authentic, row.window_newest = window._authentic, window._newest
    row.expected, row.unique = window._expected, window._unique
    row.after_leap = NONE if window._after_leap is None else window._after_leap
    row.behind, row.behind_run = window._behind, window._behind_run
    # Bit i of the window is the number i below the newest.
    bits = np.frombuffer(window._seen.to_bytes(WINDOW // 8, "little"), np.uint8)
    seen = np.unpackbits(bits, bitorder="little")
    row.seen = np.roll(seen[::-1], window._newest + 1)


def _window_from_row(window: ArrivalWindow, row: Any) -> None:
    window._newest = int(row.window_newest)
    window._expected, window._unique = int(row.expected), int(row.unique)
    window._after_leap = None if row.after_leap == NONE else int(row.after_leap)
    window._behind, window._behind_run = int(row.behind), int(row.behind_run)
    seen = np.roll(row.seen, -window._newest - 1)[::-1]
    window._seen = int.from_bytes(np.packbits(seen, bitorder="little").tobytes(), "little")


def _bucket_from_row(bucket: TokenBucket, row: Any) -> None:
    bucket._full_us = float(row.full_us)
