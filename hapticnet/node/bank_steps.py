"""Serve the sessions of a bank: take in a queue of datagrams, step the scenes, and write the answers. Compiled.

Each function does what the method it names does for one session (docs/adr/0013). A datagram that is not usual stops
the pass before anything has changed; `bank.Bank` lets Python process it and goes on after it.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import IntArray
from hapticnet.codec.payload.values import COUNT_BYTES, SINGLE_BYTES
from hapticnet.codec.positions.lines import FASTEST_M_PER_S
from hapticnet.codec.value_rows import count_of, refresh, update
from hapticnet.node.course_steps import (
    NEVER,
    due_us,
    next_step_us,
    place_at,
    present_us,
    step_and_look,
    take_in_line,
)
from hapticnet.protocol.frames import (
    ARRAY,
    BIN8,
    NIL,
    NONE,
    Bytes,
    Scratch,
    read_frame,
    read_half,
    read_position,
    read_single,
    same_address,
    set_address,
    write_double,
    write_head,
    write_number,
    write_short,
    write_single,
)
from hapticnet.protocol.repair_steps import (
    RepairNumbers,
    keepalive_is_due,
    note_sent,
    repair_is_due,
    reported,
)
from hapticnet.protocol.seal import EPOCH_BITS, LAST_SEQUENCE
from hapticnet.protocol.seal_steps import REFUSED, SEND_EPOCH, open_body, seal_body
from hapticnet.protocol.serial_number import wrap
from hapticnet.protocol.session_steps import (
    NEW,
    UNUSUAL,
    arrived,
    count_malformed,
    count_received,
    count_sent,
    hear,
    sort,
    take_token,
)
from hapticnet.protocol.wire import SEALED
from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.scene.springs import feel

FORCE: Final = 5
KEEPALIVE: Final = 6
POSITION_BYTES: Final = 4
LINE_BYTES: Final = 6
FREE: Final = -1
"""A place of the index that is empty."""

NOT_USUAL, DROPPED, POSITION = range(3)

Words = npt.NDArray[np.uint32]


class Arrivals(NamedTuple):
    """Datagrams that have arrived: bytes (n, SLOT_BYTES), lengths (n,), source addresses (n, ADDRESS_WORDS)."""

    data: Bytes
    lengths: IntArray
    addresses: Words


class Departures(NamedTuple):
    """Datagrams to send: bytes (n, ANSWER_BYTES), lengths (n,), destinations (n, ADDRESS_WORDS), how many (1,)."""

    data: Bytes
    lengths: IntArray
    addresses: Words
    number: IntArray


class Tables(NamedTuple):
    """What a pass reads and changes beside the datagrams.

    Attributes
    ----------
    rows
        The sessions.
    numbers, places
        Index of the rows: session numbers, FREE where there is none, and where their rows are.
    waiting
        Rows with a position to answer, in the order in which these arrived; the first number is how many.
    followers
        Rows whose scenes are stepped between positions; the first number is how many.
    leaving
        Rows that Python must step, because a new key begins; the first number is how many.
    seals
        What seals and opens the datagrams of each row (`seal_steps`); zeros for open sessions.
    opened
        Space for the body of a datagram.
    next_us
        When a scene is next due to be stepped between positions, NEVER for none; shape (1,).
    """

    rows: Any
    seals: IntArray
    numbers: IntArray
    places: IntArray
    waiting: IntArray
    followers: IntArray
    leaving: IntArray
    opened: Bytes
    next_us: IntArray
    scratch: Scratch


def place_of_number(number: int, mask: int) -> int:
    """Return where the search for a session number in the index begins."""
    return (number * 40503 >> 16) & mask  # Fibonacci hashing (Knuth): the numbers of a worker share their low bits


def find(tables: Tables, number: int) -> int:
    """Return the row of a session; FREE if there is none."""
    mask = tables.numbers.shape[0] - 1
    place = place_of_number(number, mask)
    while tables.numbers[place] != FREE:
        if tables.numbers[place] == number:
            return int(tables.places[place])
        place = (place + 1) & mask
    return FREE


def take_in_all(
    tables: Tables, arrivals: Arrivals, first: int, count: int, settings: RepairNumbers, now_us: int
) -> int:
    """Take in datagrams from `first` to `count` - 1; return the first one that is not usual, or `count`."""
    for number in range(first, count):
        data, length = arrivals.data[number], arrivals.lengths[number]
        frame = read_frame(data, length)
        if frame.version == 0:
            return number
        at = find(tables, frame.session)
        if at == FREE:
            return number
        row = tables.rows[at]
        if row.version != frame.version:
            return number
        body, begins, ends = data, frame.begins, frame.ends
        if row.version == SEALED:
            seal = tables.seals[at]
            if row.sequence > LAST_SEQUENCE - 2 or row.sequence >> EPOCH_BITS != seal[SEND_EPOCH]:
                return number
            body = tables.opened
            begins, ends = 0, open_body(seal, data, 0, frame.begins, length - frame.begins, frame.sequence, body, 0)
            if ends == REFUSED:
                count_malformed(row, length)
                continue
            if ends < 0:
                return number
        elif not same_address(row.address, arrivals.addresses[number]):
            return number
        taken = take_in(row, body, begins, ends, length, frame.sequence, tables.scratch, settings, now_us)
        if taken == NOT_USUAL:
            return number
        if taken == POSITION:
            if row.version == SEALED:
                set_address(row.address, arrivals.addresses[number])
            if not row.is_waiting:
                row.is_waiting = True
                tables.waiting[0] += 1
                tables.waiting[tables.waiting[0]] = at
    return count


def take_in(
    row: Any,
    body: Bytes,
    begins: int,
    ends: int,
    length: int,
    sequence: int,
    scratch: Scratch,
    settings: RepairNumbers,
    now_us: int,
) -> int:
    """Process a POSITION of `length` bytes; return NOT_USUAL with nothing changed, DROPPED, or POSITION for a new one.

    See `Station.take_in`.
    """
    position = read_position(body, begins, ends)
    size = position.payload_bytes
    if position.t_us == NONE or not (size == POSITION_BYTES or (row.follows and size == LINE_BYTES)):
        return NOT_USUAL
    x_m = read_single(body, position.payload_at, scratch)
    if not -LARGEST_COMPONENT <= x_m <= LARGEST_COMPONENT:
        return NOT_USUAL
    speed_m_per_s = read_half(body, position.payload_at + POSITION_BYTES) if size == LINE_BYTES else 0.0
    if not abs(speed_m_per_s) <= FASTEST_M_PER_S:
        return NOT_USUAL
    arrival = sort(row, sequence)
    if arrival == UNUSUAL:
        return NOT_USUAL
    count_received(row, length)
    arrived(row, sequence, arrival)
    if arrival != NEW:
        return DROPPED
    if not take_token(row, now_us):
        row.over_rate += 1
        return DROPPED
    t_us = hear(row, position.t_us, position.newest, now_us)
    if position.share >= 0.0:
        reported(row, settings, position.share, position.again, now_us)
    if row.follows:
        take_in_line(row, t_us, x_m, speed_m_per_s, now_us)
    row.superseded += row.has_position
    row.has_position = True
    row.pending_us, row.pending_m = t_us, x_m
    return POSITION


def answer_all(tables: Tables, departures: Departures, settings: RepairNumbers, now_us: int) -> None:
    """Answer the newest position of each session that has one."""
    for number in range(1, tables.waiting[0] + 1):
        at = tables.waiting[number]
        row = tables.rows[at]
        row.is_waiting = False
        if row.has_position:
            row.has_position = False
            answer(tables, at, departures, settings, now_us)
            if row.follows:
                note_next_step(tables, next_step_us(row))
    tables.waiting[0] = 0


def answer(tables: Tables, at: int, departures: Departures, settings: RepairNumbers, now_us: int) -> None:
    """Move the scene to the newest position and answer it; see `Station.answer`."""
    row = tables.rows[at]
    t_us, x_m = row.pending_us, row.pending_m
    if not row.follows:
        reply(tables, at, t_us, x_m, feel(row, x_m), departures, settings, now_us)
        return
    now_there_us = present_us(row, now_us)
    force_n = step_and_look(row, x_m)
    if row.sees and now_there_us > t_us:
        x_m = place_at(row, now_there_us)
        force_n = step_and_look(row, x_m)
    reply(tables, at, now_there_us, x_m, force_n, departures, settings, now_us)


def step_between_all(tables: Tables, departures: Departures, settings: RepairNumbers, now_us: int) -> None:
    """Step the scenes along the lines that their masters promised; see `Station.step_between`."""
    tables.next_us[0] = NEVER
    tables.leaving[0] = 0
    for number in range(1, tables.followers[0] + 1):
        at = tables.followers[number]
        row = tables.rows[at]
        t_us = due_us(row, now_us)
        if t_us != NEVER:
            if row.version == SEALED and row.sequence >> EPOCH_BITS != tables.seals[at, SEND_EPOCH]:
                tables.leaving[0] += 1
                tables.leaving[tables.leaving[0]] = at
                continue
            row.between += 1
            x_m = place_at(row, t_us)
            row.answered_us = max(t_us, row.answered_us)
            force_n = step_and_look(row, x_m)
            reply(tables, at, t_us, x_m, force_n, departures, settings, now_us)
        note_next_step(tables, next_step_us(row))


def note_next_step(tables: Tables, step_us: int) -> None:
    """Note when a scene is due to be stepped."""
    if step_us != NEVER and (tables.next_us[0] == NEVER or step_us < tables.next_us[0]):
        tables.next_us[0] = step_us


def reply(
    tables: Tables,
    at: int,
    t_us: int,
    x_m: float,
    force_n: float,
    departures: Departures,
    settings: RepairNumbers,
    now_us: int,
) -> None:
    """Send what a force takes, and account for it; see `Feedback.answer` and `Station.settle`."""
    row = tables.rows[at]
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


def depart(tables: Tables, at: int, kind: int, t_us: int, form: int, departures: Departures, now_us: int) -> None:
    """Write a FORCE or KEEPALIVE and its destination; see `SlaveSession._datagram`."""
    row, scratch = tables.rows[at], tables.scratch
    number = departures.number[0]
    departures.number[0] += 1
    out = departures.data[number]
    head_end = write_head(out, row.version, kind, row.number, row.sequence)
    begins = head_end + 2
    out[begins] = ARRAY + (3 if row.telling else 2)
    end = write_number(out, begins + 1, wrap(t_us))
    if kind == FORCE:
        out[end], out[end + 1] = BIN8, form
        end = write_value(out, end + 2, row, form, scratch)
    elif row.newest_force == NONE:
        out[end] = NIL
        end += 1
    else:
        end = write_number(out, end, row.newest_force)
    if row.telling:
        end = write_outlook(out, end, row, scratch)
    if row.version == SEALED:
        end = seal_body(tables.seals[at], out, 0, head_end, out, begins, end - begins, row.sequence)
    else:
        out[head_end], out[head_end + 1] = BIN8, end - begins
    departures.lengths[number] = end
    set_address(departures.addresses[number], row.address)
    count_sent(row, end, now_us, kind == FORCE)


def write_value(out: Bytes, at: int, row: Any, form: int, scratch: Scratch) -> int:
    """Write the payload of what the master is to hold; return where it ends. See `ValueForm.pack`."""
    if form == COUNT_BYTES:
        return write_short(out, at, count_of(row))
    if form == SINGLE_BYTES:
        return write_single(out, at, row.held_n, scratch)
    return write_double(out, at, row.held_n, scratch)


def write_outlook(out: Bytes, at: int, row: Any, scratch: Scratch) -> int:
    """Write an outlook as a byte string; return where it ends. See `pack_outlook`."""
    out[at], out[at + 1] = BIN8, 16 if row.sees else 0
    at += 2
    if row.sees:
        at = write_single(out, at, row.box_stiffness, scratch)
        at = write_single(out, at, 0.0, scratch)
        at = write_single(out, at, row.box_low_m, scratch)
        at = write_single(out, at, row.box_high_m, scratch)
    return at


BANK_FIELDS: Final[list[Any]] = [
    ("address", np.uint32, (7,)),
    ("has_position", np.bool_),
    ("is_waiting", np.bool_),
    ("pending_us", np.int64),
    ("pending_m", np.float64),
    ("superseded", np.int64),
    ("steps", np.int64),
    ("stepped_us", np.int64),
    ("newest_us", np.int64),
    ("newest_m", np.float64),
    ("transmitted", np.bool_),
    ("samples", np.int64),
    ("squares", np.float64),
    ("largest_n", np.float64),
    ("exceeded", np.int64),
    ("codec_jnd_weber", np.float64),
    ("codec_jnd_floor_n", np.float64),
    ("idle_below_n", np.float64),
]
"""Fields of a row that belong to no other room: a station's position to answer, its account, and its error."""
