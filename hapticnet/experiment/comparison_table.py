"""The tables of a comparison: for a person on a terminal, and for programs (CSV)."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

from hapticnet.channel.settings import time_in_words
from hapticnet.errors import visible
from hapticnet.experiment.comparison import REPAIR_US, Row
from hapticnet.experiment.summary import METHOD, Block, Line, blocks, means
from hapticnet.experiment.table import UNKNOWN, WIDEST, csv_text, line_width, print_table
from hapticnet.experiment.trials import Trial

LONGEST_LABEL: Final = 22  # characters of a codec on one line of a terminal: enough for every codec's name
NOTE_WIDTH: Final = 120


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the tables for people: the figure of `Row.flat` that it shows, times a factor."""

    key: str
    heading: str  # one or two lines
    form: str  # format specification of the number
    meaning: str  # explanation for the note under the table
    factor: float = 1.0

    def cell(self, line: Line) -> str:
        """Return the figure of a line, with its interval if it is a mean."""
        value = line.values.get(self.key)
        if value is None:
            return UNKNOWN
        text = format(self.factor * value, self.form)
        if self.key not in line.half_widths:
            return text
        half_width = format(self.factor * line.half_widths[self.key], self.form)
        return f"{text.removesuffix('%')} ± {half_width}"


OPTIMUM_MEANING: Final = (
    "packets over the fewest of any zero-order hold that knows the whole recording; codecs that extrapolate can"
    " be below 1; on two and three axes the optimum is a lower bound"
)
KEEPALIVES_MEANING: Final = "the same with the keepalives that a session sends while no update is due"
EXCEED_MEANING: Final = "share of the samples with an error above one JND, whatever the threshold"
FELT_MEANING: Final = (
    "share of the ticks at which the applied force is more than one JND from the true force of that tick, over a link"
    " with delay"
)
LARGE_MEANING: Final = "share of the same ticks at which they are more than 8 JND apart"
FELT_RMSE_MEANING: Final = "root mean square error of the force felt over that link"
PREDICTED_MEANING: Final = (
    "the share above one JND if the slave answers for where the hand will be (--predicted); scenes only"
)
CREATED_MEANING: Final = (
    "energy that the applied force creates over that link, as a share of the work of the hand against the true force"
)
SPEED_MEANING: Final = "time to encode and decode a sample in a stream, in plain Python on this machine"

COLUMNS: Final = (
    Column("packets_per_s", "packets\nper s", ".1f", "transmitted updates per second"),
    Column(
        "packet_rate_reduction",
        "fewer",
        ".1%",
        "share of all samples, rest and free motion included, that are not transmitted",
    ),
    Column("wire_bytes_per_s", "kB\nper s", ".2f", "updates with protocol, UDP and IPv4 headers", 1e-3),
    Column("session_wire_bytes_per_s", "kB/s +\nkeepalives", ".2f", KEEPALIVES_MEANING, 1e-3),
    Column("over_optimum", "×\noptimum", ".2f", OPTIMUM_MEANING),
    Column("worst_100ms_packets", "worst\n0.1 s", ".0f", "most packets in any 100 ms"),
    Column("rmse_n", "RMSE\nN", ".4f", "root mean square error of the applied force"),
    Column("max_error_n", "max\nN", ".3f", "largest error"),
    Column("exceed_jnd_fraction", "exceed\nJND", ".1%", EXCEED_MEANING),
    Column("felt_exceed_jnd_fraction", "felt\n> JND", ".1%", FELT_MEANING),
    Column("felt_above_8_jnd_fraction", "felt\n> 8 JND", ".1%", LARGE_MEANING),
    Column("felt_rmse_n", "felt\nRMSE N", ".3f", FELT_RMSE_MEANING),
    Column("predicted_exceed_jnd_fraction", "predicted\n> JND", ".1%", PREDICTED_MEANING),
    Column("felt_created_share", "energy\ncreated", ".1%", CREATED_MEANING),
    Column("jump_max_jnd", "jump\nJND", ".1f", "largest step between successive applied samples"),
    Column("age_mean_us", "age\nms", ".1f", "mean age of the applied update", 1e-3),
    Column("nanoseconds_per_sample", "µs per\nsample", ".2f", SPEED_MEANING, 1e-3),
)


def heading(block: Block) -> str:
    """Return what a block shows: the recordings and the threshold."""
    name = METHOD.format(count=block.recordings) if block.trial is None else block.trial
    return f"{name}; threshold {block.settings.multiplier:g} JND"


def notes(shown: Sequence[Block]) -> list[str]:
    """Return a sentence for each column, and for each peculiarity of the blocks."""
    told = [f"{column.heading.replace(chr(10), ' ')}: {column.meaning}." for column in COLUMNS]
    if any(line.label.endswith("(at rest)") for block in shown for line in block.lines):
        told.append("(at rest): depends on motion, but no positions were given (--position-column).")
    told.append(f"The delay for the felt force is {time_in_words(shown[0].settings.delay_us)} each way.")
    if any(block.settings.loss for block in shown):
        told.append(f"Updates lost at random are replaced {REPAIR_US / 1000:g} ms later, if not lost again.")
    return told


def print_rows(rows: Sequence[Row], trials: Sequence[Trial], width: int | None = None) -> None:
    """Print a comparison on stdout in lines of `width` characters; see `table.print_table`."""
    width = line_width() if width is None else width
    single = blocks(rows)
    shown = single + means(single)
    for trial in trials:
        account = trial.account()
        _print_filled(
            f"{trial.name}: {account['samples']:,} samples, {account['seconds']:.1f} s, {account['period_ms']:g} ms"
            f" apart, longest gap {account['longest_gap_ms']:g} ms",
            width,
        )
    for block in shown:
        print()
        _print_filled(heading(block), width)
        names = [line.label if width == WIDEST else _folded(line.label) for line in block.lines]
        cells = [
            [name, *(column.cell(line) for column in COLUMNS)] for name, line in zip(names, block.lines, strict=True)
        ]
        print_table(["codec", *(column.heading for column in COLUMNS)], cells, width=width)
    print(textwrap.fill(" ".join(notes(shown)), min(width, NOTE_WIDTH)))


def csv_of(rows: Sequence[Row], origin: Sequence[str] = ()) -> str:
    """Return a row for each codec, settings and recording, and for several recordings their means and intervals.

    Its ``statistic`` is "recording", "mean" or "half_width" (of the 95 % interval); `origin` are comments at the top.
    """
    found = [{"statistic": "recording", "recordings": 1, **row.flat(), "at_rest": int(row.at_rest)} for row in rows]
    head = [key for key in found[0] if key != "parameters"] if found else []
    for block in means(blocks(rows)):
        for line in block.lines:
            if line.codec is not None:
                shared = {"recordings": block.recordings, "label": line.label, "codec": line.codec}
                shared |= asdict(block.settings)
                found.append({**line.values, **shared, "statistic": "mean"})
                found.append({**line.half_widths, **shared, "statistic": "half_width"})
    return csv_text(head, [[row.get(key) for key in head] for row in found], origin)


def _print_filled(text: str, width: int) -> None:
    for line in textwrap.wrap(text, width, subsequent_indent="  "):
        print(visible(line))


def _folded(label: str) -> str:
    """Return a label on as many lines as it needs, broken before parameters."""
    lines = [""]
    for part in re.split(r"(?<=[:,])|(?= \()", label):
        if lines[-1] and len(lines[-1]) + len(part) > LONGEST_LABEL:
            lines.append("  ")
            part = part.lstrip()
        lines[-1] += part
    return "\n".join(lines)
