"""A station as a row of numbers: which stations fit, what a row consists of, and copying in both directions."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hapticnet.codec import value_rows
from hapticnet.codec.positions.outlooks import pack_outlook
from hapticnet.node.bank_tables import BANK_FIELDS
from hapticnet.node.course_steps import COURSE_FIELDS, course_from_row, course_to_row
from hapticnet.node.idle import slave_idle_below_n
from hapticnet.node.station import Station
from hapticnet.protocol.libcrypto import version
from hapticnet.protocol.session_steps import SESSION_FIELDS, session_from_row, session_to_row
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import Kind
from hapticnet.samples import PositionSample
from hapticnet.scene import springs
from hapticnet.scene.scene import Scene

ROW: Final = np.dtype(
    [*BANK_FIELDS, *SESSION_FIELDS, *springs.SPRING_FIELDS, *value_rows.VALUE_FIELDS, *COURSE_FIELDS], align=True
)


def can_fit(station: Station) -> bool:
    """Tell whether the scene, the codec and the settings of a station fit into a row; this never changes."""
    return (
        springs.fits_row(station.scene)
        and value_rows.fits_row(station.codec)
        and not station.feedback.announced
        and station.recording is None
        and station.datagrams is None
        and (station.session.seal is None or version() is not None)
    )


def fits_now(station: Station) -> bool:
    """Tell whether a station that can fit is between two positions, and has answered one already."""
    return (
        station.seated
        and station.session.state is SlaveState.OPEN
        and station.paused is None
        and station._shift_us is not None
        and station._pending is None
        and station._answered is None
        and (station.course is None or station.course.line is not None)
    )


def station_to_row(station: Station, row: Any) -> None:
    """Copy a station to a row."""
    assert isinstance(station.scene, Scene)  # noqa: S101 - `can_fit` has said so
    session_to_row(station.session, row)
    springs.scene_to_row(station.scene, row)
    value_rows.codec_to_row(station.codec, station.feedback.encoder, station.feedback.mirror, row)
    course_to_row(station.course, station._is_told, station.between, row)
    row.has_position = row.is_waiting = False
    row.superseded, row.steps, row.stepped_us = station.superseded, station.steps, station._stepped_us
    assert station.newest is not None, "a position was answered"  # noqa: S101 - for the type checker
    row.newest_us, (row.newest_m,), _, _, row.transmitted = station.newest
    error, law = station._error, station.codec.law
    row.samples, row.squares, row.largest_n, row.exceeded = error.state
    row.codec_jnd_weber, row.codec_jnd_floor_n = law.weber_fraction, law.floor_n
    row.idle_below_n = slave_idle_below_n(law)


def station_from_row(station: Station, row: Any) -> None:
    """Copy a row back to its station. A position that waits for its answer comes with it."""
    assert isinstance(station.scene, Scene)  # noqa: S101 - `can_fit` has said so
    told = None
    if station.course is not None:
        course_from_row(station.course, row)
        station._is_told = bool(row.is_told)
        told = pack_outlook(station.course.outlook)
    session_from_row(station.session, row, told)
    springs.scene_from_row(station.scene, row)
    value_rows.codec_from_row(station.feedback.encoder, station.feedback.mirror, row)
    account_to_station(station, [int(getattr(row, name)) for name in ACCOUNT])
    station._error.state = int(row.samples), float(row.squares), float(row.largest_n), int(row.exceeded)
    station._stepped_us = int(row.stepped_us)
    held_n = (float(row.held_n),)
    station.feedback.held_n = held_n
    newest_us, newest_m, force_n = int(row.newest_us), (float(row.newest_m),), (float(row.force_n),)
    station.newest = newest_us, newest_m, force_n, held_n, bool(row.transmitted)
    station._scene_us = newest_us + (station._shift_us or 0)
    if row.has_position:
        station._pending = PositionSample(int(row.pending_us), (float(row.pending_m),))


def account_to_station(station: Station, counts: Sequence[int]) -> None:
    """Set what a station has counted to the numbers of ACCOUNT."""
    received, sent = station.session.received, station.session.sent
    station.superseded, station.steps, station.between = counts[:3]
    received.packets, received.payload_bytes, received.by_kind[Kind.POSITION] = counts[3:6]
    received.late, received.duplicate, received.malformed, received.over_rate = counts[6:10]
    sent.packets, sent.payload_bytes, sent.by_kind[Kind.FORCE], sent.by_kind[Kind.KEEPALIVE] = counts[10:14]
    assert received.window is not None, "the session is open"  # noqa: S101 - for the type checker
    received.window._expected, received.window._unique = counts[14:]


ACCOUNT: Final = (
    "superseded", "steps", "between",
    "received_packets", "received_bytes", "positions", "late", "duplicate", "malformed", "over_rate",
    "sent_packets", "sent_bytes", "forces", "keepalives",
    "expected", "unique",
)  # fmt: skip
"""Columns of a row that count."""
