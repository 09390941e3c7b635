"""The paper's four conditions, played by a slave and a master process on loopback, and their results."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, Final

import numpy as np

from hapticnet.codec.registry import make_codec, parse_codec, split_codec
from hapticnet.errors import UnavailableError
from hapticnet.experiment.analysis import (
    Columns,
    Condition,
    bytes_per_penetration,
    conditions_with,
    felt_error,
    vectors,
)
from hapticnet.experiment.comparison import DELAY_US, delayed_report
from hapticnet.experiment.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY, VERMILION, legend, picture
from hapticnet.experiment.trials import Trial
from hapticnet.measure.metrics import FeltReport
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.recordings.text import read_csv
from hapticnet.runtime.overload import signs
from hapticnet.runtime.processes import Child
from hapticnet.runtime.system import OTHER
from hapticnet.scene.settings import AnySceneSettings, SceneSettings

POLL_S: Final = 0.1
CONNECT_TIMEOUT_S: Final = 10.0
FROM_SLAVE: Final = ("packet_rate_reduction", "rmse_n", "max_error_n", "exceed_jnd_fraction")
# Figures of a condition that the processes report themselves.
FROM_MASTER: Final = ("tracking_rmse_n", "round_trip", "lateness", "ticks", "missed_ticks", "scheduling", "overload")
TISSUE_LOOKS: Final = (("o", VERMILION), ("s", GREEN), ("^", PURPLE), ("D", ORANGE))
Progress = Callable[[Condition, float], None]  # with the condition being played and for how long [s]


@dataclass(frozen=True, slots=True)
class Played:
    """One condition's raw results: the reports of the two processes on its session, and their recordings."""

    condition: Condition
    slave: dict[str, Any]
    master: dict[str, Any]
    slave_overload: dict[str, Any]  # load of the machine over all conditions
    slave_samples: Columns
    master_samples: Columns


def play_conditions(
    folder: Path,
    *,
    scene: str,
    axes: int,
    codec: str,
    seed: int,
    insertions: int,
    device: str,
    rate_hz: float,
    announced: bool = False,
    on_progress: Progress,
) -> list[Played]:
    """Play the same motion under each condition with a `codec`, but the first, and return what both sides recorded.

    On one axis the hand inserts a needle; on several it palpates, and the device renders the magnitude of the force.
    Recordings and reports go to `folder`. UnavailableError repeats the message of a process that failed.
    """
    conditions = conditions_with(codec)
    slave_report = folder / "slave.json"
    hand = [] if axes == 1 else ["--operator", f"palpation:axes={axes}", "--device-takes", "norm"]
    with _slave(folder, scene, codec, slave_report) as address:
        for condition in conditions:
            arguments = ["master", "--connect", address, "--name", condition.slug, "--seed", str(seed)]
            arguments += ["--codec", condition.codec, "--multiplier", str(condition.multiplier)]
            arguments += ["--insertions", str(insertions), "--device", device, "--rate", str(rate_hz), "--first-touch"]
            arguments += ["--announced"] if announced else []
            arguments += [*hand, "--connect-timeout", str(CONNECT_TIMEOUT_S)]
            arguments += ["--record", str(_samples(folder, condition)), "--quiet"]
            arguments += ["--report", str(folder / f"master-{condition.slug}.json")]
            _play(condition, arguments, on_progress)
    report = json.loads(slave_report.read_text())
    return [_played(condition, folder, report) for condition in conditions]


def disturbances(played: list[Played]) -> str | None:
    """Return in words whether the machine was too busy, which makes delays and tracking worse; None if it was not."""
    found = [f"{each.condition.name}: {sign}" for each in played for sign in signs(each.master["overload"])]
    found += [f"slave: {sign}" for sign in signs(played[0].slave_overload)]
    if not any(each.master["scheduling"].startswith(OTHER) for each in played):
        return "; ".join(found) or None
    return "; ".join(["no real-time scheduling", *found])


def results(played: list[Played], scene: AnySceneSettings) -> list[dict[str, Any]]:
    """Return one row of figures per condition; where the scene has no tissues, contacts with bodies are counted."""
    tissues = scene.tissues if isinstance(scene, SceneSettings) else ()
    law = WeberLaw(weber_fraction=PAPER_WEBER_FRACTION, floor_n=PAPER_FLOOR_N)
    rows: list[dict[str, Any]] = []
    for each in played:
        condition, slave, master = each.condition, each.slave, each.master
        penetrations = bytes_per_penetration(each.slave_samples, contacts=not tissues)
        late, created_share = _over_a_link(condition, each.slave_samples, scene)
        predicted, _ = _over_a_link(condition, each.slave_samples, scene, predicted=True)
        by_tissue = zip(tissues, penetrations.by_tissue(tissues) if tissues else (), strict=True)
        uncompressed = rows[0]["bytes_per_penetration"] if rows else penetrations.mean
        rows.append(
            {
                "condition": condition.name,
                "codec": condition.codec,
                "multiplier": condition.multiplier,
                "samples": slave["steps"],
                "force_packets": slave["sent"]["by_kind"].get("force", 0),
                "keepalives": slave["sent"]["by_kind"].get("keepalive", 0),
                "counted": "penetration" if tissues else "contact",
                "penetrations": len(penetrations.each),
                "bytes_of_each_penetration": penetrations.each,
                "bytes_per_penetration": penetrations.mean,
                "bytes_deviation": penetrations.deviation,
                "bytes_of_each_tissue": [
                    {"tissue": tissue.name, "breach_force_n": tissue.breach_force_n, "each": own, "mean": fmean(own)}
                    for tissue, own in by_tissue
                    if own
                ],
                "byte_reduction": 1.0 - penetrations.mean / uncompressed if uncompressed else None,
                "paper_byte_reduction": condition.paper_byte_reduction,
                "paper_correct": condition.paper_correct,
                "feedback_wire_bytes": slave["sent"]["wire_bytes"],
                "felt": asdict(felt_error(law, each.slave_samples, each.master_samples)),
                "felt_over_link": {"delay_us": DELAY_US, **asdict(late), "created_share": created_share},
                "predicted_over_link": {"delay_us": DELAY_US, **asdict(predicted)},
                "lost": master["received"]["lost"] + slave["received"]["lost"],
                **{key: slave[key] for key in FROM_SLAVE},
                **{key: master[key] for key in FROM_MASTER},
                "slave_overload": each.slave_overload,
            }
        )
    return rows


def draw_bytes_per_penetration(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw the paper's Fig. 4: mean bytes per penetration in each condition, with every penetration by tissue."""
    with picture(file, 4.2) as figure:
        axes = figure.subplots()
        top = max(max([row["bytes_per_penetration"], *row["bytes_of_each_penetration"]]) for row in rows)
        for place, row in enumerate(rows):
            mean, each = row["bytes_per_penetration"], row["bytes_of_each_penetration"]
            axes.bar(place, mean, width=0.62, color=SKY if place else GREY, zorder=2)
            axes.errorbar(place, mean, yerr=row["bytes_deviation"], color=INK, capsize=5, linewidth=1.2, zorder=3)
            for number, tissue in enumerate(row["bytes_of_each_tissue"]):
                marker, colour = TISSUE_LOOKS[number % len(TISSUE_LOOKS)]
                axes.plot(
                    place + 0.085 * (number + 1) + np.linspace(-0.02, 0.02, len(tissue["each"])),
                    tissue["each"],
                    marker,
                    color=colour,
                    markersize=4.5,
                    markeredgecolor="white",
                    markeredgewidth=0.4,
                    zorder=4,
                    label=None if place else f"{tissue['tissue']}, breaks at {tissue['breach_force_n']:g} N",
                )
            saved = "" if row["byte_reduction"] is None else f"\n−{row['byte_reduction']:.1%}"
            label = f"{mean:,.0f} B" + (saved if place else "")
            highest = max([mean + row["bytes_deviation"], *each])
            axes.annotate(label, (place, highest + 0.02 * top), ha="center", va="bottom", zorder=5)
            if row["paper_byte_reduction"] and row["counted"] == "penetration":
                paper = (1.0 - row["paper_byte_reduction"]) * rows[0]["bytes_per_penetration"]
                axes.plot([place - 0.36, place + 0.36], [paper, paper], color=BLUE, linestyle="--", zorder=5)
                told = f"paper: −{row['paper_byte_reduction']:.1%}"
                axes.annotate(told, (place + 0.4, paper), va="center", color=BLUE)
        axes.set_xticks(range(len(rows)), [row["condition"] for row in rows])
        axes.grid(visible=False, axis="x")
        axes.set_ylim(0, 1.22 * top if top else 1)
        counted = rows[0]["counted"]
        axes.set_ylabel(f"feedback bytes per {counted}\n(with keepalives and UDP/IPv4 headers)")
        axes.set_xlabel("deadband threshold")
        axes.set_title(f"Bytes per {counted}: mean, standard deviation, every {counted}")
        legend(figure, axes)


@contextmanager
def _slave(folder: Path, scene: str, codec: str, report: Path) -> Iterator[str]:
    """Run a slave on a free port and yield its address; its report is written when it ends."""
    arguments = ["slave", "--listen", "127.0.0.1:0", "--scene", scene]
    arguments += ["--add-codec", split_codec(codec)[0]]  # the slave must know the user's codec too
    slave = Child([*arguments, "--record-dir", str(folder / "slave"), "--report", str(report)])
    try:
        yield slave.address()
    finally:
        slave.end()


def _play(condition: Condition, arguments: list[str], on_progress: Progress) -> None:
    started = time.monotonic()
    master = Child(arguments)
    try:
        while not master.poll():
            on_progress(condition, time.monotonic() - started)
            time.sleep(POLL_S)
        master.finish()
    finally:
        master.end()


def _played(condition: Condition, folder: Path, report: dict[str, Any]) -> Played:
    session = next((each for each in report["sessions"] if each["master"] == condition.slug), None)
    if session is None:
        raise UnavailableError(f"the slave has no session for condition {condition.name!r}")
    slave_file = folder / "slave" / f"{condition.slug}-{session['session']:08x}.csv"
    return Played(
        condition=condition,
        slave=session,
        master=json.loads((folder / f"master-{condition.slug}.json").read_text()),
        slave_overload=report["overload"],
        slave_samples=read_csv(slave_file),
        master_samples=read_csv(_samples(folder, condition)),
    )


def _over_a_link(
    condition: Condition, samples: Columns, scene: AnySceneSettings, *, predicted: bool = False
) -> tuple[FeltReport, float | None]:
    """Return what the hand would feel over a link of `DELAY_US` each way, computed from a slave's recording."""
    trial = Trial(
        name=condition.name,
        t_us=samples["t_us"].astype(np.int64),
        stimuli=vectors(samples, "force", "n"),
        positions=vectors(samples, "position", "m"),
        scene=scene,
    )
    name, parameters = parse_codec(condition.codec)
    law = WeberLaw(weber_fraction=PAPER_WEBER_FRACTION, floor_n=PAPER_FLOOR_N, multiplier=condition.multiplier)
    return delayed_report(make_codec(name, law, parameters), trial, predicted=predicted)


def _samples(folder: Path, condition: Condition) -> Path:
    return folder / f"master-{condition.slug}.csv"
