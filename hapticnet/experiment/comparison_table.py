"""The columns of a comparison, and its tables for papers and programs: LaTeX (booktabs) and CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from hapticnet.channel.quantities import format_share
from hapticnet.experiment.comparison import REPAIR_US, Row
from hapticnet.experiment.summary import METHOD, Block, Line, blocks, means

UNKNOWN: Final = "–"


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of the tables for people.

    Attributes
    ----------
    key
        The field of `Row.flat` that it shows.
    heading
        One or two lines.
    form
        Format specification of a number.
    factor
        What the field is multiplied by.
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


COLUMNS: Final = (
    Column(key="packets_per_s", heading="packets\nper s", form=".1f", meaning="transmitted updates per second"),
    Column(
        key="packet_rate_reduction",
        heading="fewer",
        form=".1%",
        meaning="share of the samples that are not transmitted",
    ),
    Column(
        key="wire_bytes_per_s",
        heading="kB\nper s",
        form=".2f",
        factor=1e-3,
        meaning="updates with protocol, UDP and IPv4 headers",
    ),
    Column(
        key="session_wire_bytes_per_s",
        heading="kB/s +\nkeepalives",
        form=".2f",
        factor=1e-3,
        meaning="the same with the keepalives that a session sends while no update is due",
        in_papers=False,
    ),
    Column(
        key="over_optimum",
        heading="×\noptimum",
        form=".2f",
        meaning="packets over the fewest that any zero-order hold needs that knows the whole recording; codecs that"
        " extrapolate can be below 1; on two and three axes the optimum is a lower bound",
    ),
    Column(
        key="worst_100ms_packets",
        heading="worst\n0.1 s",
        form=".0f",
        meaning="most packets in any 100 ms",
        in_papers=False,
    ),
    Column(key="rmse_n", heading="RMSE\nN", form=".4f", meaning="root mean square error of the applied force"),
    Column(key="max_error_n", heading="max\nN", form=".3f", meaning="largest error", in_papers=False),
    Column(
        key="exceed_jnd_fraction",
        heading="exceed\nJND",
        form=".1%",
        meaning="share of the samples with an error above one JND, whatever the threshold",
    ),
    Column(
        key="jump_max_jnd",
        heading="jump\nJND",
        form=".1f",
        meaning="largest step between successive applied samples",
        in_papers=False,
    ),
    Column(
        key="age_mean_us",
        heading="age\nms",
        form=".1f",
        factor=1e-3,
        meaning="mean age of the applied update",
        in_papers=False,
    ),
    Column(
        key="nanoseconds_per_sample",
        heading="µs per\nsample",
        form=".2f",
        factor=1e-3,
        meaning="time to encode and decode a sample in a stream, in plain Python on this machine",
        in_papers=False,
    ),
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
    ):
        if len({getattr(each.settings, key) for each in shown}) > 1:
            parts.append(text)
    return f"{name}; {', '.join(parts)}"


def notes(shown: Sequence[Block]) -> list[str]:
    """Return a sentence for each column, and for each peculiarity of the blocks."""
    told = [f"{column.heading.replace(chr(10), ' ')}: {column.meaning}." for column in COLUMNS]
    if any(line.label.endswith("(at rest)") for block in shown for line in block.lines):
        told.append("(at rest): depends on motion, but no positions were given (--position).")
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
    lines = [*(f"% {line}" for line in origin), "% Needs \\usepackage{booktabs}.", ""]
    for block in shown:
        lines += [
            "\\begin{table}",
            "  \\centering\\footnotesize\\setlength{\\tabcolsep}{4pt}",
            f"  \\caption{{{_escaped(heading(block, shown))}}}",
            f"  \\begin{{tabular}}{{l{'r' * len(columns)}}}",
            "    \\toprule",
            _latex_row(["codec", *(column.heading.replace("\n", " ") for column in columns)]),
            "    \\midrule",
        ]
        before_optimum = True
        for line in block.lines:
            if before_optimum and line.codec is None:
                lines.append("    \\addlinespace")
                before_optimum = False
            lines.append(_latex_row([line.label, *(column.cell(line) for column in columns)]))
        lines += ["    \\bottomrule", "  \\end{tabular}", "\\end{table}", ""]
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


def _latex_row(cells: Sequence[str]) -> str:
    return f"    {' & '.join(map(_escaped, cells))} \\\\"


def _escaped(text: str) -> str:
    escaped = "".join(f"\\{character}" if character in "%&_#${}" else character for character in text)
    for character, written in (("±", "$\\pm$"), ("×", "$\\times$"), ("–", "--"), ("µ", "$\\mu$")):
        escaped = escaped.replace(character, written)
    return escaped
