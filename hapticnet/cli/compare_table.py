"""The comparison's table: a block for each recording and threshold, a line for each codec, the optimum below."""

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Final

from rich import box
from rich.console import Console
from rich.table import Table

from hapticnet.channel.quantities import format_share
from hapticnet.codec.registry import CODECS
from hapticnet.experiment.comparison import REPAIR_US, Row

WIDEST: Final = 1000
"""More characters than any table needs."""


def print_rows(rows: Sequence[Row], loss: float) -> None:
    """Print a comparison on stdout."""
    # A terminal that is too narrow breaks lines, which is better than cutting numbers.
    console = Console(highlight=False, width=WIDEST)
    for (trial, multiplier), block in groupby(rows, key=lambda row: (row.trial, row.multiplier)):
        table = Table(title=f"{trial}, threshold {multiplier:g} JND", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("codec", no_wrap=True)
        for heading, _ in _COLUMNS:
            table.add_column(heading, justify="right", no_wrap=True)
        for row in block:
            table.add_row(_name(row), *(cell(row) for _, cell in _COLUMNS))
        for name, packets in (("optimum, hold", row.limits.holds), ("optimum, lines", row.limits.lines)):
            rate = row.packets_per_s * packets / row.cost.sent if row.cost.sent else 0.0
            share = packets / row.limits.holds if row.limits.holds else 1.0
            table.add_row(
                name, f"{rate:.1f}", f"{1.0 - packets / row.cost.samples:.1%}", "–", f"{share:.2f}", *["–"] * 7
            )
        console.print(table, width=console.measure(table).maximum)
    print(_FOOTNOTE)
    if loss:
        later = f"{REPAIR_US / 1000:g} ms later, if not lost again"
        print(f"{format_share(loss)} of the updates were lost, and replaced {later}.\n")


def _name(row: Row) -> str:
    moved = row.quality.energy_peak_j is not None  # which takes positions to tell
    return row.label if moved or not CODECS[row.codec].needs_position else f"{row.label} (at rest)"


_COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("packets/s", lambda row: f"{row.packets_per_s:.1f}"),
    ("fewer", lambda row: f"{row.cost.packet_rate_reduction:.1%}"),
    ("kB/s", lambda row: f"{row.wire_bytes_per_s / 1000:.2f}"),
    ("× optimum", lambda row: f"{row.over_optimum:.2f}"),
    ("worst 0.1 s", lambda row: f"{row.cost.worst_100ms_packets}"),
    ("RMSE N", lambda row: f"{row.quality.rmse_n:.4f}"),
    ("max N", lambda row: f"{row.quality.max_error_n:.3f}"),
    ("exceed JND", lambda row: f"{row.quality.exceed_jnd_fraction:.1%}"),
    ("jump JND", lambda row: f"{row.quality.jump_max_jnd:.1f}"),
    ("age ms", lambda row: f"{row.quality.age_mean_us / 1000:.1f}"),
    ("µs/sample", lambda row: f"{row.nanoseconds_per_sample / 1000:.2f}"),
)

_FOOTNOTE = """\
kB/s with protocol, UDP and IPv4 headers. × optimum: packets over the fewest that any
zero-order hold could do with, all of the future known (codec/bound.py; for two and
three axes a number that cannot be undercut). Exceed JND: share of samples at which one
JND is exceeded, whatever the threshold. Jump: between successive applied samples.
(at rest): its rule depends on motion, and no positions were given (--position).
µs/sample: encoding and decoding in a stream, plain Python, on this machine.
"""
