"""`repair.Repair` over a row of numbers: compiled for the bank. docs/adr/0013 says why it is written twice.

Each function does what the method of `Repair` with its name does, on the fields that `REPAIR_FIELDS` adds to a row;
tests/node/test_node_bank.py holds both to the same bytes.
"""

import math
from typing import Any, Final

import numpy as np

from hapticnet.protocol.loss import NO_LOSS, Loss, datagrams_needed
from hapticnet.protocol.repair import (
    GRANULARITY_US,
    LONGEST_TIMEOUT_US,
    MOST_CREDIT,
    MOST_REMEMBERED,
    PACE_STEP_US,
    REPORT_LASTS_US,
    SCHEDULING_US,
    SHORTEST_TIMEOUT_US,
    Repair,
    RepairSettings,
    Sent,
)
from hapticnet.protocol.serial_number import distance

REPAIR_FIELDS: Final[list[Any]] = [
    ("keepalive_us", np.int64),
    ("longest_us", np.int64),
    ("idle_us", np.int64),  # -1: as without idling
    ("ack_delay_us", np.int64),
    ("age_limit_us", np.int64),
    ("recovering", np.bool_),
    ("since_us", np.int64),
    ("expired_us", np.int64),
    ("spoke_us", np.int64),
    ("measured", np.bool_),  # whether there is a smoothed round trip
    ("smoothed_us", np.float64),
    ("deviation_us", np.float64),
    ("overdue_us", np.float64),
    ("timeout_us", np.float64),
    ("loss_share", np.float64),
    ("loss_again", np.float64),
    ("reported_us", np.int64),
    ("late_us", np.float64),
    ("needed", np.int64),
    ("credit", np.float64),
    ("jnd_weber", np.float64),
    ("jnd_floor_n", np.float64),
    ("sent_first", np.int64),  # place of the oldest datagram without acknowledgement
    ("sent_count", np.int64),
    ("sent_number", np.int64, (MOST_REMEMBERED,)),
    ("sent_us", np.int64, (MOST_REMEMBERED,)),
    ("sent_before_n", np.float64, (MOST_REMEMBERED,)),
]


_SETTINGS: Final[list[Any]] = [
    ("replaces", np.bool_),
    ("repeats", np.bool_),
    ("paces", np.bool_),
    ("doubt_limit", np.float64),
    ("shortest_wait_us", np.int64),
    ("longest_wait_us", np.int64),
    ("repeats_per_position", np.float64),
    ("shortest_keepalive_us", np.int64),
    ("silences_per_s", np.float64),
]


def repair_record(settings: RepairSettings) -> Any:
    """Return the fields of `RepairSettings` that compiled code uses, as one record, shape (1,)."""
    values = tuple(getattr(settings, name) for name, _ in _SETTINGS)
    return np.array([values], np.dtype(_SETTINGS, align=True)).view(np.recarray)


def place_of(row: Any, index: int) -> int:
    """Return where in the ring the datagram `index` after the oldest is."""
    return int(row.sent_first + index) & (MOST_REMEMBERED - 1)


def note_sent(row: Any, sequence: int, now_us: int, before_n: float) -> None:
    """Record a datagram that is waited for; see `Repair.sent`."""
    if row.sent_count == 0:
        row.since_us = now_us
    if row.sent_count == MOST_REMEMBERED:
        row.sent_first += 1
    else:
        row.sent_count += 1
    place = place_of(row, row.sent_count - 1)
    row.sent_number[place] = sequence
    row.sent_us[place] = now_us
    row.sent_before_n[place] = before_n


def acknowledged(row: Any, sequence: int, now_us: int) -> None:
    """See `Repair.acknowledged`."""
    if row.sent_count == 0:
        return
    oldest, newest = row.sent_number[place_of(row, 0)], row.sent_number[place_of(row, row.sent_count - 1)]
    if distance(sequence, oldest) < 0 or distance(sequence, newest) > 0:
        return
    sent_us = 0
    while row.sent_count > 0 and distance(sequence, row.sent_number[place_of(row, 0)]) >= 0:
        sent_us = row.sent_us[place_of(row, 0)]
        row.sent_first += 1
        row.sent_count -= 1
    if row.sent_count > 0:
        row.since_us = max(row.since_us, row.sent_us[place_of(row, 0)])
    if sent_us >= row.expired_us:
        row.recovering = False
    measure(row, now_us - sent_us if now_us > sent_us else 0)


def measure(row: Any, round_trip_us: int) -> None:
    """See `Repair._measure`."""
    if not row.measured:
        row.measured = True
        row.smoothed_us, row.deviation_us = round_trip_us, round_trip_us / 2
    else:
        row.deviation_us += (abs(round_trip_us - row.smoothed_us) - row.deviation_us) / 4
        row.smoothed_us += (round_trip_us - row.smoothed_us) / 8
    margin_us = 4 * row.deviation_us
    least_us = float(GRANULARITY_US + row.ack_delay_us)
    timeout_us = row.smoothed_us + (margin_us if margin_us > least_us else least_us)
    row.overdue_us = row.timeout_us = timeout_us if timeout_us > SHORTEST_TIMEOUT_US else float(SHORTEST_TIMEOUT_US)


def reported(row: Any, settings: Any, share: float, again: float, now_us: int) -> None:
    """See `Repair.reported`."""
    row.reported_us = now_us
    if settings.repeats or settings.paces:
        row.loss_share, row.loss_again = share, again
        if settings.paces:
            pace(row, settings)


def pace(row: Any, settings: Any) -> None:
    """See `Repair._pace`."""
    row.keepalive_us, row.needed = row.longest_us, 1
    if row.loss_share == 0.0:
        return
    window_us = max(row.age_limit_us - SCHEDULING_US - 4.0 * row.deviation_us, 0.5 * row.age_limit_us)
    row.needed = datagrams_needed(Loss(row.loss_share, row.loss_again), window_us, settings.silences_per_s)
    while row.keepalive_us > settings.shortest_keepalive_us:
        spacing_us = row.keepalive_us + row.late_us
        chances = window_us / spacing_us
        left_us = window_us - spacing_us - row.overdue_us
        if left_us > 0.0:
            chances = 1.0 + row.overdue_us / spacing_us
            chances += left_us / (settings.shortest_wait_us + 2.0 * row.late_us)
        if chances >= row.needed:
            return
        row.keepalive_us -= PACE_STEP_US


def repair_is_due(row: Any, settings: Any, now_us: int, force_n: float) -> bool:
    """See `Repair.is_due`."""
    if row.sent_count == 0:
        return False
    if settings.replaces and not 0 <= now_us - row.since_us <= row.timeout_us:
        row.since_us = row.expired_us = now_us
        row.recovering = True
        row.timeout_us = max(row.timeout_us, min(2 * row.timeout_us, float(LONGEST_TIMEOUT_US)))
        return True
    if row.loss_share == 0.0:
        return False
    if now_us - row.reported_us > REPORT_LASTS_US:
        reported(row, settings, 0.0, 0.0, now_us)
        return False
    row.credit = min(row.credit + settings.repeats_per_position, MOST_CREDIT)
    silent_us = now_us - row.spoke_us
    if silent_us < settings.shortest_wait_us:
        return False
    if (
        keeps_alive(row, silent_us)
        or may_be_silent(row, settings, now_us)
        or (settings.repeats and row.credit >= 1.0 and silent_us >= wait_us(row, settings, force_n))
    ):
        row.credit = max(row.credit - 1.0, 0.0)
        return True
    return False


def keepalive_is_due(row: Any, now_us: int, idle: bool) -> bool:
    """See `Repair.keepalive_is_due`."""
    silent_us = now_us - row.spoke_us
    if idle and row.idle_us >= 0 and row.loss_share == 0.0 and 0 <= silent_us < row.idle_us:
        return False
    return silent_us < 0 or keeps_alive(row, silent_us)


def keeps_alive(row: Any, silent_us: int) -> bool:
    """See `Repair._keeps_alive`."""
    if silent_us < row.keepalive_us:
        return False
    late_us = min(silent_us - row.keepalive_us, row.longest_us)
    row.late_us += (late_us - row.late_us) / 32
    return True


def may_be_silent(row: Any, settings: Any, now_us: int) -> bool:
    """See `Repair._may_be_silent`."""
    if not settings.paces or now_us - row.sent_us[place_of(row, 0)] <= row.overdue_us:
        return False
    for since in range(row.sent_count):
        if since >= row.needed:
            return False
        if now_us - row.sent_us[place_of(row, row.sent_count - 1 - since)] > row.overdue_us:
            return True
    return False


def wait_us(row: Any, settings: Any, force_n: float) -> float:
    """See `Repair._wait_us`."""
    all_lost, doubt, newest_miss, miss = row.loss_share, 0.0, 0.0, 0.0
    looked_at_all = True
    for since in range(row.sent_count):
        if doubt + all_lost <= settings.doubt_limit:
            looked_at_all = False
            break
        miss = miss_of(row, force_n, row.sent_before_n[place_of(row, row.sent_count - 1 - since)])
        if miss > 1.0:
            doubt += all_lost * (1.0 - row.loss_again)
            if newest_miss == 0.0:
                newest_miss = miss
        all_lost *= row.loss_again
    if looked_at_all and miss > 1.0:
        doubt += all_lost
    if doubt <= settings.doubt_limit:
        return math.inf
    return float(max(float(settings.shortest_wait_us), settings.longest_wait_us / newest_miss))


def miss_of(row: Any, force_n: float, before_n: float) -> float:
    """See `Repair._miss`."""
    jnd_n = max(row.jnd_weber * abs(before_n), row.jnd_floor_n)
    away_n = abs(force_n - before_n)
    if jnd_n > 0.0:
        return float(away_n / jnd_n)
    return math.inf if away_n > 0.0 else 0.0


_NUMBERS: Final = ("keepalive_us", "since_us", "expired_us", "spoke_us", "reported_us", "needed")
_FLOATS: Final = ("deviation_us", "overdue_us", "timeout_us", "late_us", "credit")


def repair_to_row(repair: Repair, row: Any) -> None:
    """Copy a repair to a row."""
    for name in (*_NUMBERS, *_FLOATS):
        setattr(row, name, getattr(repair, _private(name)))
    row.longest_us, row.age_limit_us, row.ack_delay_us = repair._longest_us, repair._age_limit_us, repair._ack_delay_us
    row.idle_us = -1 if repair._idle_us is None else repair._idle_us
    row.recovering = repair._recovering
    row.measured = repair._smoothed_us is not None
    row.smoothed_us = repair._smoothed_us or 0.0
    row.loss_share, row.loss_again = repair._loss
    row.jnd_weber, row.jnd_floor_n = repair._law.weber_fraction, repair._law.floor_n
    row.sent_first, row.sent_count = 0, len(repair._sent)
    for place, entry in enumerate(repair._sent):
        assert entry.before is not None, "only a scene that is announced needs no stimulus before"  # noqa: S101
        row.sent_number[place], row.sent_us[place] = entry.sequence, entry.sent_us
        (row.sent_before_n[place],) = entry.before


def repair_from_row(repair: Repair, row: Any) -> None:
    """Copy a row back to its repair."""
    for name in _NUMBERS:
        setattr(repair, _private(name), int(getattr(row, name)))
    for name in _FLOATS:
        setattr(repair, _private(name), float(getattr(row, name)))
    repair._recovering = bool(row.recovering)
    repair._smoothed_us = float(row.smoothed_us) if row.measured else None
    share, again = float(row.loss_share), float(row.loss_again)
    repair._loss = Loss(share, again) if share else NO_LOSS
    repair._sent.clear()
    for index in range(int(row.sent_count)):
        place = place_of(row, index)
        before = (float(row.sent_before_n[place]),)
        repair._sent.append(Sent(int(row.sent_number[place]), int(row.sent_us[place]), before))


def _private(name: str) -> str:
    return name if name == "keepalive_us" else f"_{name}"
