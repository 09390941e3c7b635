"""The columns of a comparison, and its tables for papers and programs: LaTeX (booktabs) and CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from hapticnet.channel.settings import format_share, time_in_words
from hapticnet.experiment.comparison import REPAIR_US, Row
from hapticnet.experiment.latex import PACKAGES, escaped, row, table
from hapticnet.experiment.summary import METHOD, Block, Line, blocks, means

UNKNOWN: Final = "–"


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the tables for people.

    Attributes
    ----------
    key
        The field of `Row.flat` that it shows.
    heading
        One or two lines.
    form, factor
        Format specification of the number, and what the field is multiplied by.
    meaning
        Explanation for the note under the table.
    in_papers
        Whether the LaTeX table has the column; all of them do not fit on a page.
    """

    key: str
    heading: str
    form: str
    meaning: str
    factor: float = 1.0
    in_papers: bool = True

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
    "packets over the fewest that any zero-order hold needs that knows the whole recording; codecs that extrapolate can"
    " be below 1; on two and three axes the optimum is a lower bound"
)
KEEPALIVES_MEANING: Final = "the same with the keepalives that a session sends while no update is due"
EXCEED_MEANING: Final = "share of the samples with an error above one JND, whatever the threshold"
FELT_MEANING: Final = (
    "share of the ticks at which the applied force is more than one JND from the true force of that tick, over a link"
    " with delay"
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
    Column("session_wire_bytes_per_s", "kB/s +\nkeepalives", ".2f", KEEPALIVES_MEANING, 1e-3, in_papers=False),
    Column("over_optimum", "×\noptimum", ".2f", OPTIMUM_MEANING),
    Column("worst_100ms_packets", "worst\n0.1 s", ".0f", "most packets in any 100 ms", in_papers=False),
    Column("rmse_n", "RMSE\nN", ".4f", "root mean square error of the applied force"),
    Column("max_error_n", "max\nN", ".3f", "largest error", in_papers=False),
    Column("exceed_jnd_fraction", "exceed\nJND", ".1%", EXCEED_MEANING),
    Column("felt_exceed_jnd_fraction", "felt\n> JND", ".1%", FELT_MEANING),
    Column("felt_created_share", "energy\ncreated", ".1%", CREATED_MEANING),
    Column("jump_max_jnd", "jump\nJND", ".1f", "largest step between successive applied samples", in_papers=False),
    Column("age_mean_us", "age\nms", ".1f", "mean age of the applied update", 1e-3, in_papers=False),
    Column("nanoseconds_per_sample", "µs per\nsample", ".2f", SPEED_MEANING, 1e-3, in_papers=False),
)


def heading(block: Block, shown: Sequence[Block]) -> str:
    """Return what a block shows: the recordings, the threshold, and the other settings that are not the same in all."""
    name = METHOD.format(count=block.recordings) if block.trial is None else block.trial
    settings = block.settings
    parts = [f"threshold {settings.multiplier:g} JND"]
    for key, text in (
        ("weber_fraction", f"Weber fraction {settings.weber_fraction:g}"),
        ("floor_n", f"floor {settings.floor_n:g} N"),
        ("loss", f"{format_share(settings.loss)} loss"),
        ("delay_us", f"{time_in_words(settings.delay_us)} each way"),
    ):
        if len({getattr(each.settings, key) for each in shown}) > 1:
            parts.append(text)
    return f"{name}; {', '.join(parts)}"


def notes(shown: Sequence[Block]) -> list[str]:
    """Return a sentence for each column, and for each peculiarity of the blocks."""
    told = [f"{column.heading.replace(chr(10), ' ')}: {column.meaning}." for column in COLUMNS]
    if any(line.label.endswith("(at rest)") for block in shown for line in block.lines):
        told.append("(at rest): depends on motion, but no positions were given (--position-column).")
    delays = dict.fromkeys(time_in_words(block.settings.delay_us) for block in shown)
    told.append(f"The delay for the felt force is {' or '.join(delays)} each way.")
    if any(block.settings.loss for block in shown):
        told.append(f"Updates lost at random are replaced {REPAIR_US / 1000:g} ms later, if not lost again.")
    return told


def latex(rows: Sequence[Row], origin: Sequence[str] = ()) -> str:
    """Return booktabs tables: of the means if there are several recordings, else of the only one.

    Parameters
    ----------
    origin
        Lines of comment at the top; see `provenance.provenance_lines`.
    """
    single = blocks(rows)
    shown = means(single) or single
    columns = [column for column in COLUMNS if column.in_papers]
    lines = [*(f"% {line}" for line in origin), PACKAGES, ""]
    for block in shown:
        cells = [row(["codec", *(column.heading.replace("\n", " ") for column in columns)]), "\\midrule"]
        before_optimum = True
        for line in block.lines:
            if before_optimum and line.codec is None:
                cells.append("\\addlinespace")
                before_optimum = False
            cells.append(row([line.label, *(column.cell(line) for column in columns)]))
        lines += [
            "\\begin{table}",
            "\\centering\\footnotesize\\setlength{\\tabcolsep}{4pt}",
            f"\\caption{{{escaped(heading(block, shown))}}}",
            *table(f"l{'r' * len(columns)}", cells),
            "\\end{table}",
            "",
        ]
    return "\n".join([*lines, *(f"% {note}" for note in notes(shown))]) + "\n"


def csv_text(rows: Sequence[Row], origin: Sequence[str] = ()) -> str:
    """Return a row for each codec, settings and recording, and for several recordings their means and intervals.

    The column ``statistic`` is "recording", "mean" or "half_width": half of the 95 % interval around the mean. Units
    are those of `Row.flat`; values that do not exist are empty.

    Parameters
    ----------
    origin
        Lines of comment at the top, after ``#``; see `provenance.provenance_lines`.
    """
    single = [{"statistic": "recording", "recordings": 1, **_scalars(row.flat())} for row in rows]
    averaged = []
    for block in means(blocks(rows)):
        for line in block.lines:
            if line.codec is not None:
                shared = {"recordings": block.recordings, "label": line.label, "codec": line.codec}
                settings = asdict(block.settings)
                averaged.append({"statistic": "mean", **line.values, **shared, **settings})
                averaged.append({"statistic": "half_width", **line.half_widths, **shared, **settings})
    text = io.StringIO()
    text.writelines(f"# {line}\n" for line in origin)
    writer = csv.DictWriter(text, list(single[0]) if single else [], restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(single + averaged)
    return text.getvalue()


def _scalars(flat: Mapping[str, Any]) -> dict[str, Any]:
    cells = {key: value for key, value in flat.items() if key != "parameters"}
    return cells | {"at_rest": int(flat["at_rest"])}
