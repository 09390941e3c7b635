"""Answer a position from a row of a bank: encode the force, write the datagram, and account for it. Compiled."""

from typing import Any, Final

from hapticnet.codec.payload.values import COUNT_BYTES, SINGLE_BYTES
from hapticnet.codec.value_rows import count_of, refresh, update
from hapticnet.node.bank_tables import DEPARTING, Datagrams, Tables
from hapticnet.protocol.frames import (
    ARRAY,
    BIN8,
    NIL,
    NONE,
    Bytes,
    set_address,
    write_double,
    write_head,
    write_number,
    write_short,
    write_single,
)
from hapticnet.protocol.repair_steps import keepalive_is_due, note_sent, repair_is_due
from hapticnet.protocol.seal_steps import seal_body
from hapticnet.protocol.serial_number import wrap
from hapticnet.protocol.session_steps import count_sent
from hapticnet.protocol.wire import SEALED, Kind

FORCE: Final = int(Kind.FORCE)
KEEPALIVE: Final = int(Kind.KEEPALIVE)


def reply(tables: Tables, at: int, t_us: int, x_m: float, force_n: float, departures: Datagrams, now_us: int) -> None:
    """Send the update or keepalive that a force needs, if any, and account for it.

    See `Feedback.answer` and `Station.settle`.
    """
    row, settings = tables.rows[at], tables.repair[0]
    if row.follows:
        row.answered_us = max(t_us, row.answered_us)
    row.steps += 1
    before_n = row.held_n
    is_due = repair_is_due(row, settings, now_us, force_n)
    if is_due:
        refresh(row)
    form = update(row, force_n)
    if form:
        row.newest_force = row.sequence
        sequence = row.sequence
        depart(tables, at, FORCE, t_us, form, departures, now_us)
        note_sent(row, sequence, now_us, before_n)
    elif is_due or (row.telling and row.told_since == NONE) or is_silent_for_long(row, force_n, now_us):
        if row.telling or (settings.paces and row.loss_share != 0.0):
            note_sent(row, row.sequence, now_us, before_n)
        depart(tables, at, KEEPALIVE, t_us, 0, departures, now_us)
    row.stepped_us = now_us
    row.newest_us, row.newest_m, row.transmitted = t_us, x_m, form > 0
    error_n = abs(force_n - row.held_n)
    row.samples += 1
    row.squares += error_n * error_n
    row.largest_n = max(row.largest_n, error_n)
    if error_n > max(row.codec_jnd_weber * abs(row.held_n), row.codec_jnd_floor_n):
        row.exceeded += 1


def is_silent_for_long(row: Any, force_n: float, now_us: int) -> bool:
    """See `Feedback._keepalive_is_due`."""
    felt_n = max(abs(force_n), abs(row.held_n))
    return keepalive_is_due(row, now_us, felt_n < row.idle_below_n)


def depart(tables: Tables, at: int, kind: int, t_us: int, form: int, departures: Datagrams, now_us: int) -> None:
    """Write a FORCE or KEEPALIVE and its destination; see `SlaveSession._datagram`."""
    row = tables.rows[at]
    number = tables.state[DEPARTING]
    tables.state[DEPARTING] += 1
    out = departures.octets[number]
    head_end = write_head(out, row.version, kind, row.number, row.sequence)
    begins = head_end + 2
    out[begins] = ARRAY + (3 if row.telling else 2)
    end = write_number(out, begins + 1, wrap(t_us))
    if kind == FORCE:
        out[end], out[end + 1] = BIN8, form
        end = write_value(out, end + 2, row, form)
    elif row.newest_force == NONE:
        out[end] = NIL
        end += 1
    else:
        end = write_number(out, end, row.newest_force)
    if row.telling:
        end = write_outlook(out, end, row)
    if row.version == SEALED:
        end = seal_body(tables.seals[at], out, 0, head_end, out, begins, end - begins, row.sequence)
    else:
        out[head_end], out[head_end + 1] = BIN8, end - begins
    departures.lengths[number] = end
    set_address(departures.addresses[number], row.address)
    count_sent(row, end, now_us, kind == FORCE)


def write_value(out: Bytes, at: int, row: Any, form: int) -> int:
    """Write the payload of the force that the master is to hold; return where it ends. See `ValueForm.pack`."""
    if form == COUNT_BYTES:
        return write_short(out, at, count_of(row))
    if form == SINGLE_BYTES:
        return write_single(out, at, row.held_n)
    return write_double(out, at, row.held_n)


def write_outlook(out: Bytes, at: int, row: Any) -> int:
    """Write an outlook as a byte string; return where it ends. See `pack_outlook`."""
    out[at], out[at + 1] = BIN8, 16 if row.sees else 0
    at += 2
    if row.sees:
        at = write_single(out, at, row.box_stiffness)
        at = write_single(out, at, 0.0)
        at = write_single(out, at, row.box_low_m)
        at = write_single(out, at, row.box_high_m)
    return at
