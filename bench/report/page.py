"""Write docs/benchmarks.md and its figures from the results of the benchmarks; what is missing is named as missing."""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import page_codecs
import page_fairness
import page_nodes
import page_published
import page_speed
from page_markdown import Row, listed, table
from page_targets import targets

BENCH: Final = Path(__file__).parent

Section = Callable[[Row], list[str]]

SECTIONS: Final[Sequence[tuple[str, str, Section]]] = (
    ("rate_distortion", "Signals", page_codecs.signals),
    ("rate_distortion", "Packets over the best possible", page_codecs.over_optimum),
    ("rate_distortion", "Which codec wins where", page_codecs.winners),
    ("rate_distortion", "Packets at equal error", page_fairness.equal_error),
    ("rate_distortion", "What is in the tuning", page_fairness.settings),
    ("rate_distortion", "Packets over the sampling rate", page_fairness.sampling),
    ("rate_distortion", "Error, age and energy", page_codecs.errors),
    ("rate_distortion", "The steps a person feels", page_published.steps),
    ("rate_distortion", "Loss", page_published.losses),
    ("rate_distortion", "Published reductions", page_published.regimes),
    ("rate_distortion", "Entropy-coded payloads", page_published.payloads),
    ("rate_distortion", "Cost against error", page_published.cost),
    ("codec_speed", "Codec speed", page_speed.codec_speed),
    ("codec_stability", "Numerical stability of the codecs", page_nodes.codec_stability),
    ("packet_rate", "The paper's figure over the sampling rate", page_nodes.packet_rate),
    ("scene_accuracy", "Accuracy of the scene over its rate", page_nodes.scene_accuracy),
    ("scene_cost", "Cost of the scene", page_speed.scene_cost),
    ("force_loop", "The fingertip's force loop", page_nodes.force_loop),
    ("virtual_time", "Both nodes in virtual time", page_speed.virtual_time),
    ("loop", "The real-time loop", page_speed.loop),
)

FIGURES: Final = {
    "rate_distortion": ("plot_rate_distortion.py", ""),
    "packet_rate": ("plot_packet_rate.py", "packet_rate.png"),
    "scene_accuracy": ("plot_scene_accuracy.py", "scene_accuracy.png"),
    "force_loop": ("plot_force_loop.py", "force_loop.png"),
}
"""Script that draws from a result, and the picture it is told to write; else the folder."""


def page(records: dict[str, Row]) -> str:
    """Return the page."""
    parts = [
        "# Benchmarks",
        (
            "`make bench` measures everything anew and writes this page, its figures, and the results as JSON to"
            " `results/bench`. No number and no name of a winner here is written by hand."
        ),
        "## Targets",
        *targets(records),
        "## Set-up",
        *setup(records),
    ]
    for name, title, section in SECTIONS:
        parts.append(f"## {title}")
        parts += (
            section(records[name]["results"]) if name in records else [f"Not measured (`bench/measure/{name}.py`)."]
        )
    return "\n\n".join(parts) + "\n"


def setup(records: dict[str, Row]) -> list[str]:
    """Return on what, with which code and seeds, all was measured."""
    if not records:
        return ["Nothing has been measured."]
    machines = {(record["machine"]["cores"], record["machine"]["python"]) for record in records.values()}
    where = listed([f"{cores} cores with {python}" for cores, python in sorted(machines, key=str)])
    return [
        (
            f"Machine: {where}. What is counted (packets, bytes, errors) is the same on any machine for a seed; what is"
            " timed holds for that machine and whatever else it had to do, so that ratios within a run say more."
        ),
        table(
            ("benchmark", "revision", "seed", "repetitions"),
            (
                (f"`bench/measure/{name}.py`", record["revision"], str(record["seed"]), str(record["repetitions"]))
                for name, record in records.items()
            ),
        ),
    ]


def draw(folder: Path, records: dict[str, Row], figures: Path) -> None:
    """Draw the pictures of every result that has some."""
    figures.mkdir(parents=True, exist_ok=True)
    for name, (script, file) in FIGURES.items():
        if name in records:
            command = [sys.executable, BENCH / script, folder / f"{name}.json", "--out", figures / file]
            subprocess.run(command, check=True)


def main() -> None:
    """Read what there is, draw, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="?", default=BENCH.parents[1] / "results" / "bench", help="folder")
    parser.add_argument(
        "--out", type=Path, default=BENCH.parents[1] / "docs", metavar="DIR", help="where the page goes"
    )
    arguments = parser.parse_args()
    records = {}
    names = dict.fromkeys(name for name, _, _ in SECTIONS)
    for name in names:
        file = arguments.results / f"{name}.json"
        if file.exists():
            records[name] = json.loads(file.read_text(encoding="utf-8"))
    draw(arguments.results, records, arguments.out / "figures")
    (arguments.out / "benchmarks.md").write_text(page(records), encoding="utf-8")
    print(f"{arguments.out / 'benchmarks.md'}: {len(records)} of {len(names)} benchmarks")


if __name__ == "__main__":
    main()
