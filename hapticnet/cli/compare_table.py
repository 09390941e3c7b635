"""The comparison's table: a block for each recording and threshold, a line for each codec, the optimum below."""

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Final

from rich import box
from rich.console import Console
from rich.table import Table

from hapticnet.channel.quantities import format_share
from hapticnet.experiment.comparison import REPAIR_US, Row, Trial

WIDEST: Final = 1000
"""More characters than any table needs."""


def print_rows(rows: Sequence[Row], trials: Sequence[Trial], loss: float) -> None:
    """Print a comparison on stdout."""
    described = {trial.name: describe(trial) for trial in trials}
    # A terminal that is too narrow breaks lines, which is better than cutting numbers.
    console = Console(highlight=False, width=WIDEST)
    for (trial, multiplier), block in groupby(rows, key=lambda row: (row.trial, row.multiplier)):
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("codec", no_wrap=True)
        for heading, _ in _COLUMNS:
            table.add_column(heading, justify="right", no_wrap=True)
        for row in block:
            table.add_row(_name(row), *(cell(row) for _, cell in _COLUMNS))
        for name, packets in (("optimum, hold", row.limits.holds), ("optimum, lines", row.limits.lines)):
            rate = row.packets_per_s * packets / row.cost.sent if row.cost.sent else 0.0
            share = packets / row.limits.holds if row.limits.holds else 1.0
            table.add_row(
                name, f"{rate:.1f}", f"{1.0 - packets / row.cost.samples:.1%}", "–", "–", f"{share:.2f}", *["–"] * 7
            )
        print(f"{described[trial]}; threshold {multiplier:g} JND")
        console.print(table, width=console.measure(table).maximum)
    print(_FOOTNOTE)
    if loss:
        later = f"{REPAIR_US / 1000:g} ms later, if not lost again"
        print(f"{format_share(loss)} of the updates were lost, and replaced {later}.\n")


def describe(trial: Trial) -> str:
    """Return what a recording is, so that a wrong rate or a gap is seen."""
    account = trial.account()
    return (
        f"{trial.name}, {account['samples']:,} samples, {account['seconds']:.1f} s, {account['period_ms']:g} ms apart,"
        f" longest gap {account['longest_gap_ms']:g} ms"
    )


def _name(row: Row) -> str:
    return f"{row.label} (at rest)" if row.at_rest else row.label


_COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("packets/s", lambda row: f"{row.packets_per_s:.1f}"),
    ("fewer", lambda row: f"{row.cost.packet_rate_reduction:.1%}"),
    ("kB/s", lambda row: f"{row.wire_bytes_per_s / 1000:.2f}"),
    ("+ keepalives", lambda row: f"{row.session_wire_bytes_per_s / 1000:.2f}"),
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
fewer: packets than samples. kB/s: the forces, with protocol, UDP and IPv4 headers; + keepalives: with those that a
session says while no force is sent. × optimum: packets over the fewest that any zero-order hold could do with, all of
the future known; what extrapolates may be below (on two and three axes the optimum is a lower bound). worst 0.1 s:
most packets in 100 ms. exceed JND: share of samples at which one JND is exceeded, whatever the threshold. jump: largest
between successive applied samples. age: mean, of the stimulus being applied. µs/sample: encoding and decoding in a
stream, plain Python, on this machine. (at rest): its rule depends on motion, and no positions were given (--position).
"""
