"""What was felt one round trip later, and what the sender learns from that.

Over a network with delay, a receiver applies at its present position an update that is a round trip old. Once it has
the stimulus of that position, the sender knows how wrong each kind of line was, but for losses and jitter, and which
stiffness and viscosity would have been right. Foam is stiffer the further it is pressed, and softer on the way back:
both are therefore learned in cells of similar force and velocity.
"""

import math
from typing import Any, Final, TypeAlias

from hapticnet.codec.schemes.contact import LARGEST_CHANGE, LARGEST_MOTION, SMALLEST_THRESHOLD_N, Coupling, solved
from hapticnet.codec.schemes.motion import SURFACE, Line, Motion, line_at
from hapticnet.codec.schemes.predictors import MotionRule
from hapticnet.codec.steps import MakeTable
from hapticnet.codec.values import threshold_around
from hapticnet.samples import Vector
from hapticnet.vectors import distance, dot, magnitude, minus

FELT_EVERY: Final = 12  # samples from one that is judged to the next: enough to compare lines, and cheap
REMEMBERED: Final = 64  # such samples that are remembered: at 1 kHz 0.8 s, the longest round trip that counts
LEAST_ROUND_TRIP_US: Final = 3_000  # a shorter one counts as none: hands move half a millimetre in it
LATE_US: Final = 100_000.0  # how much older than a round trip a sample may be to be judged [µs]

LOSS_US: Final = 400_000.0  # time constant of the losses [µs]
LARGEST_LOSS: Final = 40.0  # largest error that counts, in thresholds
MARGIN: Final = 0.8  # another kind of line is taken if its loss is less than this share of the present one's

FORCE_UNIT_N: Final = 0.1
SPEED_UNIT_M_S: Final = 0.02
FORCE_WIDTH: Final = 0.6
SPEED_WIDTH: Final = 0.8
"""Width of cells, in the natural logarithm of one plus the force or speed in its unit."""

FORCES: Final = 10
SPEEDS: Final = 4
"""Cells on each side of zero; the last one has no end. Each holds normal equations, as `contact.Coupling` does."""

FADING: Final = 0.99  # factor on what a cell has learned at each further observation
PRIOR: Final = 0.003  # weight of the coupling that is learned without cells, for cells that are new
LARGEST_LEARNED_VISCOSITY: Final = 100.0  # [N·s/m]; a larger one is noise

TIME: Final = 0
STIFFNESS: Final = 1
VISCOSITY: Final = 2
CELL: Final = 3
ACROSS: Final = 4
VECTORS: Final = 5
"""Numbers of a remembered sample: time [µs], stiffness and viscosity of similar ones, index of its cell, stiffness
across the surface; then the vectors force, position, velocity, and offset and normal of the surface."""

SURFACE_LINE: Final = 0
TIMED_LINE: Final = 1
SIMILAR_LINE: Final = 2
COUPLED_LINE: Final = 3
HELD_LINE: Final = 4
"""Kinds of lines. The first three are judged: the surface, what follows time alone, the coupling of similar samples."""

Felt: TypeAlias = tuple[int, int, tuple[float, float, float], int, int]
"""``(written, behind, losses, wanted, chosen)``.

Samples remembered, and the number of the one that is a round trip old; how wrong each kind of line was recently, in
thresholds; the best kind at present, and the kind sent last."""


def felt_tables(axes: int, table: MakeTable) -> tuple[Any, Any, Any]:
    """Return the round trip, room for samples, and cells."""
    return table(1, 1), table(REMEMBERED, VECTORS + 5 * axes), table(4 * FORCES * SPEEDS, 5)


NOTHING_FELT: Final = 0, 0, (0.0, 0.0, 0.0), SURFACE_LINE, SURFACE_LINE


def part(numbers: Any, at: int, like: Vector) -> Vector:
    """Return the vector that begins at an index."""
    if len(like) == 1:
        return (numbers[at],)
    if len(like) == 2:
        return numbers[at], numbers[at + 1]
    return numbers[at], numbers[at + 1], numbers[at + 2]


def placed(x: float, width: float, cells: int) -> float:
    """Return the place of a number among cells, from 0 to twice `cells`."""
    place = min(math.log(1.0 + abs(x)) / width, cells - 1e-6)
    return cells + place if x >= 0.0 else cells - place


def similar_coupling(cells: Any, coupling: Coupling, x: Vector, velocity: Vector) -> tuple[float, float, int]:
    """Return stiffness and viscosity of similar samples, from the four nearest cells, and the index of the nearest.

    On two and three axes, similar are the magnitude of the force and the velocity along it.
    """
    force, speed = x[0], velocity[0]
    if len(x) > 1:
        force = magnitude(x)
        speed = dot(x, velocity) / force if force > SMALLEST_THRESHOLD_N else 0.0
    force = placed(force / FORCE_UNIT_N, FORCE_WIDTH, FORCES)
    speed = placed(speed / SPEED_UNIT_M_S, SPEED_WIDTH, SPEEDS)
    i, j = int(force), int(speed)
    off_i, off_j = force - i - 0.5, speed - j - 0.5
    next_i = min(i + 1, 2 * FORCES - 1) if off_i > 0.0 else max(i - 1, 0)
    next_j = min(j + 1, 2 * SPEEDS - 1) if off_j > 0.0 else max(j - 1, 0)
    share_i, share_j = abs(off_i), abs(off_j)
    nearest = 2 * SPEEDS * i + j
    a, b = cells[nearest], cells[2 * SPEEDS * next_i + j]
    c, d = cells[2 * SPEEDS * i + next_j], cells[2 * SPEEDS * next_i + next_j]
    of_a, of_b = (1.0 - share_i) * (1.0 - share_j), share_i * (1.0 - share_j)
    of_c, of_d = (1.0 - share_i) * share_j, share_i * share_j
    (xx, xv, vv), (fx, fv) = coupling.normal, coupling.right
    xx = PRIOR * xx + of_a * a[0] + of_b * b[0] + of_c * c[0] + of_d * d[0]
    xv = PRIOR * xv + of_a * a[1] + of_b * b[1] + of_c * c[1] + of_d * d[1]
    vv = PRIOR * vv + of_a * a[2] + of_b * b[2] + of_c * c[2] + of_d * d[2]
    fx = PRIOR * fx + of_a * a[3] + of_b * b[3] + of_c * c[3] + of_d * d[3]
    fv = PRIOR * fv + of_a * a[4] + of_b * b[4] + of_c * c[4] + of_d * d[4]
    stiffness, viscosity = solved((xx, xv, vv), (fx, fv))
    return stiffness, min(viscosity, LARGEST_LEARNED_VISCOSITY), nearest


def feel(rule: MotionRule, felt: Felt, motion: Motion, t_us: int, x: Vector, surface: Line, coupling: Coupling) -> Felt:
    """Judge and learn from the sample that is one round trip old, and remember the present one."""
    written, behind, losses, wanted, chosen = felt
    _, samples, _, position, velocity = motion
    if samples == 0:
        return felt
    rows, round_trip_us, axes = rule.remembered, rule.round_trip_us[0][0], len(x)
    behind = max(behind, written - REMEMBERED)
    while behind + 1 < written and rows[(behind + 1) % REMEMBERED][TIME] <= t_us - round_trip_us:
        behind += 1
    then = rows[behind % REMEMBERED]
    threshold_n = threshold_around(rule.numbers, x)
    is_due = written > 0 and round_trip_us <= t_us - then[TIME] <= 2.0 * round_trip_us + LATE_US
    if is_due and threshold_n > SMALLEST_THRESHOLD_N:
        scale = 1.0 / threshold_n
        if axes == 1:  # as below without a dozen calls
            f, p, v = x[0] - then[VECTORS], position[0] - then[VECTORS + 1], velocity[0] - then[VECTORS + 2]
            xx, xv, vv, fx, fv, ff = p * p, p * v, v * v, f * p, f * v, f * f
        else:
            change, faster = minus(x, part(then, VECTORS, x)), minus(velocity, part(then, VECTORS + 2 * axes, x))
            moved = minus(position, part(then, VECTORS + axes, x))
            xx, xv, vv = dot(moved, moved), dot(moved, faster), dot(faster, faster)
            fx, fv, ff = dot(change, moved), dot(change, faster), dot(change, change)
        s, d = then[STIFFNESS], then[VISCOSITY]
        similar = math.sqrt(max(ff + s * (s * xx + 2.0 * (d * xv - fx)) + d * (d * vv - 2.0 * fv), 0.0))
        offset, normal = part(then, VECTORS + 3 * axes, x), part(then, VECTORS + 4 * axes, x)
        line = Line(SURFACE, 0, offset, offset, normal, then[ACROSS], 0.0)
        pressed = distance(x, line_at(rule.numbers, line, True, position, velocity, t_us))
        elapsed_us = min(max(t_us - rows[(written - 1) % REMEMBERED][TIME], 0.0), LOSS_US)
        share = elapsed_us / (LOSS_US + elapsed_us)
        a, b, c = losses
        a += share * (min(scale * pressed, LARGEST_LOSS) - a)
        b += share * (min(scale * math.sqrt(ff), LARGEST_LOSS) - b)
        c += share * (min(scale * similar, LARGEST_LOSS) - c)
        losses = a, b, c
        wanted = better(losses, wanted)
        square = scale * scale
        if square * (xx + vv) <= LARGEST_MOTION and square * ff <= LARGEST_CHANGE:
            cell = rule.cells[int(then[CELL])]
            for k, term in enumerate((xx, xv, vv, fx, fv)):
                cell[k] = FADING * cell[k] + square * term
    now = rows[written % REMEMBERED]
    now[TIME], now[ACROSS] = t_us, surface.stiffness
    now[STIFFNESS], now[VISCOSITY], now[CELL] = similar_coupling(rule.cells, coupling, x, velocity)
    for axis in range(axes):
        at = VECTORS + axis
        now[at], now[at + axes], now[at + 2 * axes] = x[axis], position[axis], velocity[axis]
        now[at + 3 * axes], now[at + 4 * axes] = surface.offset[axis], surface.normal[axis]
    return written + 1, behind, losses, wanted, chosen


def better(losses: tuple[float, float, float], wanted: int) -> int:
    """Return the best kind of line: the present one, unless another is clearly better."""
    best = wanted
    for line in range(len(losses)):
        if losses[line] < losses[best]:
            best = line
    return best if losses[best] < MARGIN * losses[wanted] else wanted
