"""The demo's table: one column per condition, with the paper's figures for comparison."""

from collections.abc import Callable
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

Row = dict[str, Any]


def print_table(rows: list[Row]) -> None:
    """Print the results of the conditions on stdout."""
    table = Table(title="Four conditions, the same motion", box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0))
    table.add_column("")
    for row in rows:
        table.add_column(row["condition"], justify="right")
    counted = rows[0]["counted"]
    for label, cell in _LINES:
        if counted == "contact" and label.strip().startswith("paper"):
            continue
        table.add_row(label.replace("penetration", counted), *(cell(row) for row in rows))
        if label == "  standard deviation":
            for tissue in rows[0]["bytes_of_each_tissue"]:
                means = [_of_tissue(row, tissue["tissue"]) for row in rows]
                table.add_row(f"  {tissue['tissue']} ({tissue['breach_force_n']:g} N)", *means)
    Console(highlight=False).print(table)
    print((_PAPER if counted == "penetration" else "") + _FOOTNOTE.replace("penetration", counted))


def _of_tissue(row: Row, name: str) -> str:
    means = [tissue["mean"] for tissue in row["bytes_of_each_tissue"] if tissue["tissue"] == name]
    return f"{means[0]:,.0f}" if means else "–"


def _percent(value: float | None, sign: str = "") -> str:
    return "–" if value is None else f"{sign}{value:.1%}"


def _milliseconds(key: str, name: str) -> Callable[[Row], str]:
    def cell(row: Row) -> str:
        value = row[key][name]
        return "–" if value is None else f"{value / 1000:.2f} ms"

    return cell


def _reduction(row: Row) -> str:
    return "–" if row["codec"] == "raw" else _percent(row["byte_reduction"], "−")


def _paper_reduction(row: Row) -> str:
    if row["codec"] == "raw":
        return "–"
    return _percent(row["paper_byte_reduction"], "−") if row["paper_byte_reduction"] else "more"


def _tracking(row: Row) -> str:
    return "–" if row["tracking_rmse_n"] is None else f"{row['tracking_rmse_n']:.3f} N"


_PAPER = """\
Paper: "Cutaneous haptic deadband compression". It states neither its sampling
rate nor its motion, and the reduction grows with the rate: docs/benchmarks/tables.md
has the rate at which it is the paper's.
"""

_FOOTNOTE = """\
Bytes per penetration are those from the touch of a tissue to its breach, and
include keepalives and UDP and IPv4 headers. The standard deviation is
over all penetrations; lines below it are the means of each tissue, with its
breach force. The packet-rate reduction counts force packets only. "As felt"
compares the force held at each tick with the true force at the position of that
tick, so it includes the delay. "Over 25 ms" repeats this in virtual time, with
the recorded motion and that delay each way. "Energy created" is the energy that
the delayed force adds to the hand's motion, as a share of the work of the hand
against the true force. The device is late because its servos take a pulse every
20 ms and then need time to move; with --announced it knows of a breach in
advance (docs/use/device.md)."""

_LINES: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("samples", lambda row: f"{row['samples']:,}"),
    ("force packets", lambda row: f"{row['force_packets']:,}"),
    ("packet-rate reduction", lambda row: _percent(row["packet_rate_reduction"])),
    ("bytes per penetration", lambda row: f"{row['bytes_per_penetration']:,.0f}"),
    ("  standard deviation", lambda row: f"{row['bytes_deviation']:,.0f}"),
    ("  against none", _reduction),
    ("  paper", _paper_reduction),
    ("all bytes back, kB", lambda row: f"{row['feedback_wire_bytes'] / 1000:,.1f}"),
    ("  keepalives in them", lambda row: f"{row['keepalives']:,}"),
    ("paper: ordered right", lambda row: _percent(row["paper_correct"])),
    ("RMSE of the codec", lambda row: f"{row['rmse_n']:.4f} N"),
    ("largest error", lambda row: f"{row['max_error_n']:.4f} N"),
    ("exceed-JND fraction", lambda row: _percent(row["exceed_jnd_fraction"])),
    ("RMSE as felt", lambda row: f"{row['felt']['rmse_n']:.4f} N"),
    ("above 1 JND over 25 ms", lambda row: _percent(row["felt_over_link"]["exceed_jnd_fraction"])),
    ("  energy created", lambda row: _percent(row["felt_over_link"]["created_share"])),
    ("device tracking RMSE", _tracking),
    ("round trip p50", _milliseconds("round_trip", "p50_us")),
    ("  p99", _milliseconds("round_trip", "p99_us")),
    ("  p99.9", _milliseconds("round_trip", "p99_9_us")),
    ("tick lateness p50", _milliseconds("lateness", "p50_us")),
    ("  p99", _milliseconds("lateness", "p99_us")),
    ("  p99.9", _milliseconds("lateness", "p99_9_us")),
    ("missed ticks", lambda row: f"{row['missed_ticks']}"),
)
