"""`course.Course` over a row of numbers, for scenes of springs: compiled for the bank (docs/adr/0013).

Springs have no damping, so that only position and stiffness of an outlook matter.
"""

from typing import Any, Final

import numpy as np

from hapticnet.codec.positions.lines import PromisedLine
from hapticnet.codec.positions.outlooks import STIFFEST
from hapticnet.node.course import GRACE, RELAXATION, Course
from hapticnet.outlook import LONGEST_SILENCE_US, SOFTEST_COVERED, Outlook
from hapticnet.protocol.frames import NONE
from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.scene.springs import feel, look

COURSE_FIELDS: Final[list[Any]] = [
    ("follows", np.bool_),  # positions are sent only when they matter
    ("line_us", np.int64),
    ("line_m", np.float64),
    ("line_m_per_s", np.float64),
    ("answered_us", np.int64),
    ("offset_us", np.int64),
    ("course_heard_us", np.int64),
    ("period_us", np.int64),
    ("is_told", np.bool_),
    ("sees", np.bool_),  # whether there is an outlook
    ("box_stiffness", np.float64),
    ("box_low_m", np.float64),
    ("box_high_m", np.float64),
    ("between", np.int64),
]

LONGEST_US: Final = int(GRACE * LONGEST_SILENCE_US)
"""How long a line is followed [µs]."""

NEVER: Final = -(1 << 62)
"""Stands for a time that never comes."""


def take_in_line(row: Any, t_us: int, x_m: float, speed_m_per_s: float, now_us: int) -> None:
    """See `Course.take_in`."""
    offset_us = now_us - t_us
    if abs(offset_us - row.offset_us) > GRACE * LONGEST_SILENCE_US:
        row.answered_us = t_us
    else:
        elapsed_us = max(now_us - row.course_heard_us, 0)
        offset_us = min(offset_us, row.offset_us + elapsed_us // RELAXATION)
    row.line_us, row.line_m, row.line_m_per_s = t_us, x_m, speed_m_per_s
    row.offset_us, row.course_heard_us = offset_us, now_us


def present_us(row: Any, now_us: int) -> int:
    """See `Course.present_us`."""
    late = max(now_us - row.offset_us - row.line_us, 0) // row.period_us
    return int(max(row.line_us + min(late * row.period_us, LONGEST_SILENCE_US), row.answered_us))


def next_step_us(row: Any) -> int:
    """See `Course.next_step_us`; NEVER for none."""
    if not row.sees:
        return NEVER
    after_us = ((row.answered_us - row.line_us) // row.period_us + 1) * row.period_us
    return int(row.line_us + after_us + row.offset_us) if after_us <= LONGEST_US else NEVER


def due_us(row: Any, now_us: int) -> int:
    """Return the newest time on the line that has come [µs], NEVER if it was answered; see `Course.due`."""
    step_us = next_step_us(row)
    if step_us == NEVER or now_us < step_us:
        return NEVER
    steps = (now_us - row.offset_us - row.line_us) // row.period_us
    t_us = row.line_us + min(steps * row.period_us, LONGEST_US)
    return int(t_us) if t_us > row.answered_us else NEVER


def place_at(row: Any, t_us: int) -> float:
    """See `Course.at`."""
    elapsed_us = min(t_us - row.line_us, LONGEST_SILENCE_US)
    x_m = row.line_m
    if elapsed_us > 0:
        x_m = x_m + 1e-6 * elapsed_us * row.line_m_per_s
        x_m = min(max(x_m, -LARGEST_COMPONENT), LARGEST_COMPONENT)
    if row.sees:
        x_m = min(max(x_m, row.box_low_m), row.box_high_m)
    return float(x_m)


def step_and_look(row: Any, x_m: float) -> float:
    """Step the scene, and note what the master must be told; return the force [N]. See `Station._look`."""
    force_n = feel(row, x_m)
    stiffness, low_m, high_m = look(row)
    sees = low_m <= x_m <= high_m
    stiffness, low_m, high_m = up(stiffness), up(low_m), down(high_m)
    sees = sees and stiffness <= STIFFEST and low_m <= high_m and low_m <= x_m <= high_m
    if row.is_told and not sees and not row.sees:
        return force_n
    if row.is_told and row.sees and sees and covers(row, stiffness, low_m, high_m, x_m):
        return force_n
    row.sees = sees
    if sees:
        row.box_stiffness, row.box_low_m, row.box_high_m = stiffness, low_m, high_m
    row.is_told = True
    row.telling, row.told_since = True, NONE
    return force_n


def covers(row: Any, stiffness: float, low_m: float, high_m: float, x_m: float) -> bool:
    """See `Outlook.covers`."""
    return bool(
        row.box_low_m <= x_m <= row.box_high_m
        and SOFTEST_COVERED * row.box_stiffness <= stiffness <= row.box_stiffness
        and row.box_low_m >= low_m
        and row.box_high_m <= high_m
    )


def up(x: float) -> float:
    """Return the smallest float32 that is not below a number."""
    single = np.float32(x)
    return float(np.nextafter(single, np.float32(np.inf)) if float(single) < x else single)


def down(x: float) -> float:
    """Return the largest float32 that is not above a number."""
    single = np.float32(x)
    return float(np.nextafter(single, np.float32(-np.inf)) if float(single) > x else single)


def course_to_row(course: Course | None, is_told: bool, between: int, row: Any) -> None:
    """Copy a course to a row."""
    row.follows = course is not None
    row.is_told, row.between, row.sees = is_told, between, False
    if course is None or course.line is None:
        return
    row.line_us, (row.line_m,), (row.line_m_per_s,) = course.line
    row.answered_us, row.offset_us = course._answered_us, course._offset_us
    row.course_heard_us, row.period_us = course._heard_us, course._period_us
    if course.outlook is not None:
        row.sees = True
        row.box_stiffness, _, (row.box_low_m,), (row.box_high_m,) = course.outlook


def course_from_row(course: Course, row: Any) -> None:
    """Copy a row back to its course."""
    course.line = PromisedLine(int(row.line_us), (float(row.line_m),), (float(row.line_m_per_s),))
    course._answered_us, course._offset_us = int(row.answered_us), int(row.offset_us)
    course._heard_us = int(row.course_heard_us)
    course.outlook = None
    if row.sees:
        low_m, high_m = float(row.box_low_m), float(row.box_high_m)
        course.outlook = Outlook(float(row.box_stiffness), 0.0, (low_m,), (high_m,))
