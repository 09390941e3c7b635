"""Serve the sessions of a bank: take in a queue of datagrams, step the scenes, and answer. Compiled.

Each function does what the method it names does for one session (docs/adr/0013). A datagram that is not usual stops
the pass before anything has changed; `bank.Bank` lets Python process it and goes on after it.
"""

from typing import Any, Final

from hapticnet.codec.positions.lines import FASTEST_M_PER_S
from hapticnet.node.bank_answers import reply
from hapticnet.node.bank_tables import FOLLOWERS, FREE, LEAVING, NEXT_US, WAITING, Datagrams, Tables, append, find
from hapticnet.node.course_steps import NEVER, due_us, next_step_us, place_at, present_us, step_and_look, take_in_line
from hapticnet.protocol.frames import (
    NONE,
    Bytes,
    read_frame,
    read_half,
    read_position,
    read_single,
    same_address,
    set_address,
)
from hapticnet.protocol.repair_steps import reported
from hapticnet.protocol.seal import EPOCH_BITS, LAST_SEQUENCE
from hapticnet.protocol.seal_steps import REFUSED, SEND_EPOCH, open_body
from hapticnet.protocol.session_steps import (
    NEW,
    UNUSUAL,
    arrived,
    count_malformed,
    count_received,
    hear,
    sort,
    take_token,
)
from hapticnet.protocol.wire import SEALED
from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.scene.springs import feel

POSITION_BYTES: Final = 4
LINE_BYTES: Final = 6
"""Sizes of the payload of a POSITION: position, or position and velocity (`codec.positions.lines`)."""

NOT_USUAL, DROPPED, POSITION = range(3)


def serve(
    tables: Tables, arrivals: Datagrams, departures: Datagrams, first: int, count: int, answers: bool, now_us: int
) -> int:
    """Take in datagrams from number `first` to `count` - 1; then answer, if asked to.

    Return the number of the first one that is not usual, before any answer, or `count`.
    """
    for number in range(first, count):
        if not take_in_one(tables, arrivals, number, now_us):
            return number
    if answers:
        answer_all(tables, departures, now_us)
    return count


def take_in_one(tables: Tables, arrivals: Datagrams, number: int, now_us: int) -> bool:
    """Take in a datagram; return False if it is not usual. Nothing has changed then."""
    data, length, address = arrivals.octets[number], arrivals.lengths[number], arrivals.addresses[number]
    frame = read_frame(data, length)
    at = find(tables, frame.session) if frame.version else FREE
    if at == FREE:
        return False
    row = tables.rows[at]
    if row.version != frame.version:
        return False
    body, begins, ends = data, frame.begins, frame.ends
    if row.version == SEALED:
        seal = tables.seals[at]
        if row.sequence > LAST_SEQUENCE - 2 or row.sequence >> EPOCH_BITS != seal[SEND_EPOCH]:
            return False
        body = tables.opened
        begins, ends = 0, open_body(seal, data, 0, frame.begins, length - frame.begins, frame.sequence, body, 0)
        if ends == REFUSED:
            count_malformed(row, length)
            return True
        if ends < 0:
            return False
    elif not same_address(row.address, address):
        return False
    taken = take_in(row, tables.repair[0], body, begins, ends, length, frame.sequence, now_us)
    if taken == POSITION:
        if row.version == SEALED:
            set_address(row.address, address)
        if not row.is_waiting:
            row.is_waiting = True
            append(tables.lists, WAITING, at)
    return taken != NOT_USUAL


def take_in(
    row: Any, settings: Any, body: Bytes, begins: int, ends: int, length: int, sequence: int, now_us: int
) -> int:
    """Process a POSITION of `length` bytes; return NOT_USUAL with nothing changed, DROPPED, or POSITION for a new one.

    See `Station.take_in`.
    """
    position = read_position(body, begins, ends)
    size = position.payload_bytes
    if position.t_us == NONE or not (size == POSITION_BYTES or (row.follows and size == LINE_BYTES)):
        return NOT_USUAL
    x_m = read_single(body, position.payload_at)
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


def answer_all(tables: Tables, departures: Datagrams, now_us: int) -> None:
    """Answer the newest position of each session that has one."""
    for number in range(1, tables.lists[WAITING, 0] + 1):
        at = tables.lists[WAITING, number]
        row = tables.rows[at]
        row.is_waiting = False
        if row.has_position:
            row.has_position = False
            answer(tables, at, departures, now_us)
            if row.follows:
                note_next_step(tables, next_step_us(row))
    tables.lists[WAITING, 0] = 0


def answer(tables: Tables, at: int, departures: Datagrams, now_us: int) -> None:
    """Move the scene to the newest position and answer it; see `Station.answer`."""
    row = tables.rows[at]
    t_us, x_m = row.pending_us, row.pending_m
    if not row.follows:
        reply(tables, at, t_us, x_m, feel(row, x_m), departures, now_us)
        return
    now_there_us = present_us(row, now_us)
    force_n = step_and_look(row, x_m)
    if row.sees and now_there_us > t_us:
        x_m = place_at(row, now_there_us)
        force_n = step_and_look(row, x_m)
    reply(tables, at, now_there_us, x_m, force_n, departures, now_us)


def step_between_all(tables: Tables, departures: Datagrams, now_us: int) -> None:
    """Step the scenes along the lines that their masters promised; see `Station.step_between`."""
    tables.state[NEXT_US] = NEVER
    tables.lists[LEAVING, 0] = 0
    for number in range(1, tables.lists[FOLLOWERS, 0] + 1):
        at = tables.lists[FOLLOWERS, number]
        row = tables.rows[at]
        t_us = due_us(row, now_us)
        if t_us != NEVER:
            if row.version == SEALED and row.sequence >> EPOCH_BITS != tables.seals[at, SEND_EPOCH]:
                append(tables.lists, LEAVING, at)
                continue
            row.between += 1
            x_m = place_at(row, t_us)
            row.answered_us = max(t_us, row.answered_us)
            force_n = step_and_look(row, x_m)
            reply(tables, at, t_us, x_m, force_n, departures, now_us)
        note_next_step(tables, next_step_us(row))


def note_next_step(tables: Tables, step_us: int) -> None:
    """Note when a scene is due to be stepped."""
    if step_us != NEVER and (tables.state[NEXT_US] == NEVER or step_us < tables.state[NEXT_US]):
        tables.state[NEXT_US] = step_us
