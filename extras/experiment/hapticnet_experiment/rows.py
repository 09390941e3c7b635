"""The rows of a session's table: one for each event, with a name, a unit and a description for each column.

A table is a TSV file with PsychoPy's names where PsychoPy has one. Every event has the same columns; missing values or
inapplicable ones are ``n/a``.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias, TypeVar, get_args, get_type_hints

from hapticnet.errors import FileError, printable, visible

MISSING: Final = "n/a"

Event: TypeAlias = Literal[
    "begin", "consent", "meet", "started", "practice", "trial", "aborted", "repeated", "rating", "break",
    "noise", "stopped", "end",
]  # fmt: skip
"""The kind of a row.

``begin``: the session began, or continued after a crash. ``consent``: the participant agreed, or ``text`` says why the
plan asks for no consent. ``meet``: the platform found the finger. ``started``: the presentation of a trial or pair
began. ``practice``: a practice trial was answered. ``trial``: a trial was answered; only these are analysed.
``aborted``: a trial ended without a valid answer, for ``reason``, and is repeated. ``repeated``: a trial was answered,
but the device did not deliver its forces; it is repeated. ``rating``: a quality of experience was given for the block.
``break``: a break is over. ``noise``: the page plays masking noise at the level in ``text``, a share of full scale; 0
is off. ``stopped``: the session was ended early, for ``reason``; it can continue. ``end``: the session is complete.
"""


def column(description: str, *, name: str | None = None) -> Any:
    """Return a field that is ``n/a`` unless given, with the description for the sidecar."""
    return dataclasses.field(default=None, metadata={"name": name, "description": description})


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Columns of every table."""

    event: Event
    participant: str
    session: int
    this_n: int | None = column("Number of this row's trial in the schedule, from 0.", name="trials.thisN")
    this_rep_n: int | None = column("How often this condition was presented before, from 0.", name="trials.thisRepN")
    attempt: int | None = column("How often this trial was begun before, from 0.")
    onset_s: float | None = column("Start of the event, in seconds since the start of the session.")
    duration_s: float | None = column("Duration of the event in seconds.")
    response_time_s: float | None = column(
        "Time in seconds from the end of the stimulus, or the start of the scene, to the answer.", name="key_resp.rt"
    )
    key: str | None = column("The keys of the answer.", name="key_resp.keys")
    reason: str | None = column("Why the trial was not accepted.")
    text: str | None = column("Further information, such as the SHA-256 of the text agreed to.")
    observer: str | None = column("Name of the simulated observer; n/a for a person.")
    device: str | None = column("The fingertip device.")
    missed_ticks: int | None = column("Ticks of the master that were skipped because the process was late.")
    link_stale: int | None = column("How often the link went silent.")
    seed: int | None = column("Seed of the trial.")
    version: str | None = column("Version of hapticnet.")
    date: str | None = column("Date and time (UTC) at which the row was written.")


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderRow(Row):
    """A row of the ordering task.

    Numbers 1 to 3 in names are the tissues from front to back, of which the properties make tuples. An order names the
    tissues from softest to hardest, such as "213".
    """

    block: int | None = column("Number of the block, from 0.")
    condition: str | None = column("Name of the condition.")
    codec: str | None = column("Codec of the force.")
    multiplier: float | None = column("Threshold of the codec in JNDs; 0 without compression.")
    weber_fraction: float | None = column("Weber fraction of the threshold.")
    floor_n: float | None = column("Smallest JND of the threshold in newton.")
    jnd_source: str | None = column("Where the JND of the threshold comes from: the participant's file, or the plan.")
    breach_force_1_n: float | None = column("Breach force of the first tissue in newton.")
    breach_force_2_n: float | None = column("Breach force of the second tissue in newton.")
    breach_force_3_n: float | None = column("Breach force of the third tissue in newton.")
    stiffness_1_n_per_m: float | None = column("Stiffness of the first tissue in newton per metre.")
    stiffness_2_n_per_m: float | None = column("Stiffness of the second tissue in newton per metre.")
    stiffness_3_n_per_m: float | None = column("Stiffness of the third tissue in newton per metre.")
    order_true: str | None = column("Tissues from softest to hardest.")
    order_answered: str | None = column("Tissues from softest to hardest, as answered.")
    correct: int | None = column("1 if the whole order is right, else 0.", name="key_resp.corr")
    pairs_correct: int | None = column("Pairs of tissues in the right order, 0 to 3.")
    first_contact_s: float | None = column("Time in seconds from the start of the scene to the first contact.")
    contact_to_answer_s: float | None = column("Time in seconds from the first contact to the answer.")
    insertions: int | None = column("How often the needle entered the first tissue.")
    penetrations: int | None = column("Surfaces breached.")
    peak_held_1_n: float | None = column("Largest force held while in contact with the first tissue, in newton.")
    peak_held_2_n: float | None = column("Largest force held while in contact with the second tissue, in newton.")
    peak_held_3_n: float | None = column("Largest force held while in contact with the third tissue, in newton.")
    peak_sensed_1_n: float | None = column("Largest force sensed at the finger in the first tissue, in newton.")
    peak_sensed_2_n: float | None = column("Largest force sensed at the finger in the second tissue, in newton.")
    peak_sensed_3_n: float | None = column("Largest force sensed at the finger in the third tissue, in newton.")
    peak_speed_m_per_s: float | None = column("Largest speed into the tissue while in contact, in metres per second.")
    perceptual_error: float | None = column(
        "Root mean square of ln(held force / force of the tissue at the same moment) while the tissue's is above"
        " 0.3 N; a smaller held force counts as 0.3 N."
    )
    force_packets: int | None = column("FORCE datagrams that the slave sent in this trial, thinking time included.")
    wire_bytes: int | None = column("Bytes of the FORCE datagrams with their UDP and IPv4 headers.")
    penetration_packets: int | None = column(
        "Datagrams that the slave sent from the touch of a tissue to its breach, over all penetrations."
    )
    penetration_bytes: int | None = column("Bytes of these datagrams with their UDP and IPv4 headers.")
    rating: int | None = column("How the tissues of the block felt, 1 to 7.")

    @property
    def breach_forces_n(self) -> tuple[float | None, ...]:
        """Breach forces [N], front to back."""
        return self.breach_force_1_n, self.breach_force_2_n, self.breach_force_3_n

    @property
    def peaks_held_n(self) -> tuple[float | None, ...]:
        """Largest held forces [N], front to back."""
        return self.peak_held_1_n, self.peak_held_2_n, self.peak_held_3_n

    @property
    def peaks_sensed_n(self) -> tuple[float | None, ...]:
        """Largest sensed forces [N], front to back."""
        return self.peak_sensed_1_n, self.peak_sensed_2_n, self.peak_sensed_3_n


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsRow(Row):
    """A row of the measurement of the JND: one pair of stimuli and the answer to it."""

    method: str | None = column("How the JND is measured: ascending or up-down.")
    series: int | None = column("Number of the series in the schedule, from 0.")
    step: int | None = column("Number of the pair within the series, from 0.")
    catch: int | None = column("1 if both stimuli of the series stay the same, else 0.")
    reference_n: float | None = column("Reference force in newton.")
    difference_n: float | None = column("Comparison minus reference, in newton.")
    comparison_interval: int | None = column("The interval with the comparison, 1 or 2.")
    answer: str | None = column("The answer: same or different, or the interval felt as stronger.")
    correct: int | None = column("1 if the answer to two intervals is right, else 0.", name="key_resp.corr")
    held_1_n: float | None = column("Force held in the first interval, in newton.")
    held_2_n: float | None = column("Force held in the second interval, in newton.")
    sensed_1_n: float | None = column("Mean force sensed in the second half of the first interval, in newton.")
    sensed_2_n: float | None = column("Mean force sensed in the second half of the second interval, in newton.")


AnyRow = TypeVar("AnyRow", bound=Row)


def columns(kind: type[Row]) -> dict[str, str]:
    """Return the attribute of each column by the name of the column, in the order of the table."""
    return {each.metadata.get("name") or each.name: each.name for each in dataclasses.fields(kind)}


def to_line(row: Row) -> str:
    """Return a row as a line of the table, with its line feed."""
    return "\t".join(_write(getattr(row, name)) for name in columns(type(row)).values()) + "\n"


def header(kind: type[Row]) -> str:
    """Return the first line of a table."""
    return "\t".join(columns(kind)) + "\n"


def from_cells(kind: type[AnyRow], names: Sequence[str], cells: Sequence[str]) -> AnyRow:
    """Return the row of a table with columns `names`; raise FileError if a cell is missing or cannot be read."""
    if len(names) != len(cells):
        raise FileError(f"the row has {len(cells)} cells; the table has {len(names)} columns")
    types = get_type_hints(kind)
    attributes = columns(kind)
    values: dict[str, Any] = {}
    for name, cell in zip(names, cells, strict=True):
        attribute = attributes.get(name)
        if attribute is not None:
            values[attribute] = _read(name, cell, types[attribute])
    try:
        return kind(**values)
    except TypeError as error:
        raise FileError("the table has no column event, participant or session") from error


def sidecar(kind: type[Row], levels: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """Return the description of each column, for a JSON file beside the table; `levels` is `Texts.levels`."""
    described: dict[str, Any] = {
        "event": {"Description": "Kind of the row.", "Levels": {name: name for name in get_args(Event)}},
        "participant": {"Description": "Number of the participant."},
        "session": {"Description": "Number of the session."},
    }
    for each in dataclasses.fields(kind):
        if "description" in each.metadata:
            name = each.metadata["name"] or each.name
            described[name] = {"Description": each.metadata["description"]}
            unit = _unit(each.name)
            if unit is not None:
                described[name]["Units"] = unit
            if each.name in levels:
                described[name]["Levels"] = dict(levels[each.name])
    return described


def _unit(name: str) -> str | None:
    for suffix, unit in (("_m_per_s", "m/s"), ("_n_per_m", "N/m"), ("_s", "s"), ("_n", "N")):
        if name.endswith(suffix) and name not in ("this_n", "this_rep_n"):
            return unit
    return None


def _write(value: object) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return MISSING
    if isinstance(value, float):
        return f"{value:.9g}"
    return printable(str(value)) or MISSING


def _read(name: str, cell: str, kind: Any) -> Any:
    if cell == MISSING:
        return None
    options = get_args(kind)
    try:
        if kind is int or int in options:
            return int(cell)
        if kind is float or float in options:
            return float(cell)
    except ValueError as error:
        raise FileError(f"column {name}: {cell[:40]!r} is not a number") from error
    return visible(cell)
