"""Play the ordering task under many thresholds, and show how several kinds of simulated observers answer.

::

    python measure_observers.py --out results/observers

Every number of observers.md comes from here. No person takes part.
"""

import argparse
import dataclasses
import json
import math
from itertools import permutations
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.experiment.provenance import provenance
from hapticnet.experiment.style import COLOURS, DASHES, MARKERS, VERMILION, legend, picture
from hapticnet.experiment.workers import workers
from hapticnet.perception import WeberLaw
from hapticnet_experiment.analysis import PAPER_ERRORS
from hapticnet_experiment.figures import mark_level
from hapticnet_experiment.observers import OBSERVERS, Look, Observer, ObserverSettings, contacts, judged
from hapticnet_experiment.plan import ConditionPlan, JndPlan, Plan
from hapticnet_experiment.rig import play_trial
from hapticnet_experiment.trial import stimulus_of

PAPER: Final = {0.0: 0.775, 1.0: 0.8, 2.0: 0.675, 4.0: 0.5375}
THRESHOLDS: Final = (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 8.0)
FIXED_STEPS_N: Final = (0.0, 0.4, 0.8)
"""Thresholds that are the same at every force; 0.4 and 0.8 N are 11 and 23 % of the middle breach force."""
NEWTON: Final = JndPlan(weber_fraction=0.0, floor_n=1.0)
LINEAR: Final = Plan(condition=[ConditionPlan(name="linear, 4 JND", codec="linear-predictive", multiplier=4.0)])
"""A threshold of 4 JND that is never felt as steps: between updates a line is followed."""
PEOPLE: Final = 8
TRIALS: Final = 10
FATIGUE: Final = 1.75
"""Factor of noise from the first block to the last that turns 77.5 % into 53.75 %: closed form, .448/.257."""

MECHANISMS: Final[dict[str, ObserverSettings]] = {
    "deadband alone": OBSERVERS["fitted"],
    "step masking": OBSERVERS["step-masking"],
    "step lapses": OBSERVERS["step-lapses"],
    "rhythm": OBSERVERS["rhythm"],
}


class Felt(NamedTuple):
    """What was felt in the trials of one condition, tissues from softest to hardest. Arrays have shape (trials, 3)."""

    condition: str
    multiplier: float
    means: dict[str, FloatArray]  # mean of each attribute of `Look` over the contacts of a trial
    counts: FloatArray  # number of contacts
    bytes_per_penetration: float  # mean, from the touch of a tissue to its breach


def play_library(plan: Plan, *, motions: int, jobs: int, seed: int = 1) -> list[Felt]:
    """Play every order of the tissues under every condition of a plan, with several motions of the hand each."""
    orders = list(permutations(plan.order.breach_forces_n))
    tasks = [
        (condition, forces_n, seed + 1000 * motion + order)
        for condition in plan.condition
        for order, forces_n in enumerate(orders)
        for motion in range(motions)
    ]
    with workers(jobs, plan) as run:
        played = list(run(_play, tasks))
    own = len(orders) * motions
    return [_felt(condition, played[i * own : (i + 1) * own]) for i, condition in enumerate(plan.condition)]


def _play(plan: Plan, task: tuple[ConditionPlan, Any, int]) -> tuple[list[list[Look]], float]:
    """Return the contacts with each tissue, softest first, and the bytes per penetration."""
    condition, forces_n, seed = task
    law = WeberLaw(weber_fraction=plan.jnd.weber_fraction, floor_n=plan.jnd.floor_n)
    stimulus = stimulus_of(plan, condition, law, number=1, breach_forces_n=forces_n, seed=seed)
    outcome = play_trial(stimulus)
    looks, softest = contacts(outcome), sorted(range(3), key=forces_n.__getitem__)
    ranked = [[look for look in looks if look.tissue == tissue] for tissue in softest]
    return ranked, outcome.measures.penetration_bytes / max(outcome.measures.penetrations, 1)


def _felt(condition: ConditionPlan, played: list[tuple[list[list[Look]], float]]) -> Felt:
    names = [field.name for field in dataclasses.fields(Look)]
    means = {
        name: np.array(
            [[np.mean([getattr(look, name) for look in own]) if own else 0.0 for own in ranked] for ranked, _ in played]
        )
        for name in names
    }
    counts = np.array([[float(len(own)) for own in ranked] for ranked, _ in played])
    return Felt(condition.name, condition.threshold, means, counts, float(np.mean([spent for _, spent in played])))


def plan_of(thresholds: tuple[float, ...], unit: str = "JND", jnd: JndPlan | None = None) -> Plan:
    """Return the paper's plan with other thresholds, in JNDs or in a unit that `jnd` gives."""
    conditions = [
        ConditionPlan(name=f"{each:g} {unit}", codec="deadband" if each else "raw", multiplier=each)
        for each in thresholds
    ]
    return Plan(condition=conditions, jnd=jnd or JndPlan())


def answered(
    observer: ObserverSettings, felt: Felt, rng: np.random.Generator, experiments: int, factor: FloatArray | float = 1.0
) -> "np.ndarray[tuple[int, ...], np.dtype[np.int64]]":
    """Return orders, shape (experiments · people · trials, 3); a perfect observer always answers 0, 1, 2."""
    people = np.exp(rng.normal(0.0, observer.spread, (experiments * PEOPLE, 1)))
    noisier = np.repeat(people, TRIALS, axis=0) * factor
    drawn = rng.integers(len(felt.counts), size=len(noisier))
    peaks_n, updates, steps = (felt.means[name][drawn] for name in ("peak_n", "updates", "step"))
    return judged(observer, peaks_n, updates, steps, felt.counts[drawn], rng, factor=noisier)


def figures(orders: Any, experiments: int) -> dict[str, Any]:
    """Return the share of correct orders, and of soft and hard swapped among the wrong ones."""
    right = (orders == np.arange(3)).all(axis=1)
    each = right.reshape(experiments, PEOPLE * TRIALS).mean(axis=1)
    place = np.argsort(orders, axis=1)
    return {
        "correct": float(right.mean()),
        "low": float(np.quantile(each, 0.025)),
        "high": float(np.quantile(each, 0.975)),
        "ends_swapped_among_wrong": float((place[:, 0] > place[:, 2])[~right].mean()) if (~right).any() else math.nan,
    }


def measured(library: list[Felt], observers: dict[str, ObserverSettings], experiments: int) -> list[dict[str, Any]]:
    """Return the figures of each observer under each condition."""
    rows: list[dict[str, Any]] = []
    for name, observer in observers.items():
        for felt in library:
            rng = np.random.default_rng([7, len(rows)])
            row = {"observer": name, "condition": felt.condition, "threshold": felt.multiplier}
            rows.append({**row, **figures(answered(observer, felt, rng, experiments), experiments)})
    return rows


def limits_rows(settings: ObserverSettings, people: int = 200) -> list[dict[str, float]]:
    """Return the Weber fraction that an ascending method of limits finds, for several steps and criteria.

    Each series starts between 0 and 3 % of the reference and ends with the first "different"; five for each of 0.5, 1
    and 1.5 N.
    """
    rows: list[dict[str, Any]] = []
    for criterion in (1.0, 1.64, 2.33):
        for step in (0.005, 0.01, 0.02, 0.05):
            rng = np.random.default_rng(5)
            observer = Observer(dataclasses.replace(settings, criterion=criterion), rng)
            found = []
            for reference_n in (0.5, 1.0, 1.5):
                for _ in range(5 * people):
                    share = float(rng.uniform(0.0, 0.03))
                    while share < 1.0 and not observer.different(reference_n, reference_n * (1.0 + share)):
                        share += step
                    found.append(share)
            rows.append({"criterion": criterion, "step": step, "weber_fraction": float(np.mean(found))})
    return rows


def felt_row(felt: Felt) -> dict[str, Any]:
    """Return what the finger felt under one condition."""
    peaks = felt.means["peak_n"]
    return {
        "condition": felt.condition,
        "peaks_n": peaks.mean(axis=0).round(3).tolist(),
        "sd_of_ln": np.log(peaks).std(axis=0).round(4).tolist(),
        "updates": felt.means["updates"].mean(axis=0).round(1).tolist(),
        "step": round(float(felt.means["step"].mean()), 4),
        "bytes": round(felt.bytes_per_penetration, 1),
    }


def main() -> None:
    """Measure, print the tables, and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=int, default=2, help="motions of the hand for each order of tissues")
    parser.add_argument("--experiments", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/observers"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    def play(plan: Plan) -> list[Felt]:
        return play_library(plan, motions=arguments.motions, jobs=arguments.jobs)

    library = play(plan_of(THRESHOLDS))
    of_paper = [felt for felt in library if felt.multiplier in PAPER]
    unfitted = {name: OBSERVERS[name] for name in ("literature", "force-only")}
    middle = [felt for felt in library if felt.multiplier in (0.0, 4.0)]
    result: dict[str, Any] = {
        "provenance": provenance(),
        "motions": arguments.motions,
        "felt": [felt_row(felt) for felt in library],
        "observers": measured(of_paper, unfitted, arguments.experiments),
        "mechanisms": measured(library, MECHANISMS, arguments.experiments),
        "fixed_steps": measured(play(plan_of(FIXED_STEPS_N, "N", NEWTON)), MECHANISMS, arguments.experiments),
        "linear": measured(play(LINEAR), MECHANISMS, arguments.experiments),
        "limits": limits_rows(OBSERVERS["literature"]),
        "fatigue": [
            {
                "factor": factor,
                **figures(
                    answered(OBSERVERS["fitted"], middle[0], np.random.default_rng(3), arguments.experiments, factor),
                    arguments.experiments,
                ),
            }
            for factor in (1.0, math.sqrt(FATIGUE), FATIGUE)
        ],
    }
    (arguments.out / "observers.json").write_text(json.dumps(result, indent=1) + "\n")
    draw(result, arguments.out / "observers.png")
    print("\n".join(tables(result)))


def tables(result: dict[str, Any]) -> list[str]:
    """Return every table as lines of Markdown."""
    lines = ["| | felt peaks [N] | sd of ln | updates a contact | step |", "|---|---|---|---|---|"]
    for row in result["felt"]:
        cells = [" ".join(map(str, row[key])) for key in ("peaks_n", "sd_of_ln", "updates")]
        lines.append(f"| {row['condition']} | {' | '.join(cells)} | {row['step']:.3f} |")
    for key in ("observers", "mechanisms", "fixed_steps", "linear"):
        conditions = list(dict.fromkeys(row["condition"] for row in result[key]))
        lines += ["", key, "", f"| | {' | '.join(conditions)} |", "|---" * (len(conditions) + 1) + "|"]
        for name in dict.fromkeys(row["observer"] for row in result[key]):
            own = [row for row in result[key] if row["observer"] == name]
            cells = [f"{100 * row['correct']:.1f} [{100 * row['low']:.0f}, {100 * row['high']:.0f}]" for row in own]
            lines.append(f"| {name} | {' | '.join(cells)} |")
    lines += ["", "softest and hardest swapped, of wrong orders at 4 JND", ""]
    fatigued = {"observer": "fatigue", "threshold": 4.0, **result["fatigue"][-1]}
    lines += [
        f"- {row['observer']}: {100 * row['ends_swapped_among_wrong']:.0f} %"
        for row in [*result["mechanisms"], fatigued]
        if row["threshold"] == 4.0
    ]
    lines += ["", "ascending limits: criterion, step, Weber fraction", ""]
    lines += [
        f"- {row['criterion']}, {100 * row['step']:.1f} %: {row['weber_fraction']:.3f}" for row in result["limits"]
    ]
    lines += ["", "noise grown by, and correct", ""]
    lines += [f"- {row['factor']:.2f}: {100 * row['correct']:.1f} %" for row in result["fatigue"]]
    return lines


def draw(result: dict[str, Any], file: Path) -> None:
    """Draw the shares of correct orders beside the paper's, for thresholds in JNDs and in newton."""
    with picture(file, 3.6) as figure:
        axes = figure.subplots(1, 2, width_ratios=(3, 2), sharey=True)
        for number, name in enumerate(MECHANISMS):
            look = {"color": COLOURS[(0, 2, 3, 5)[number]], "marker": MARKERS[number], "linestyle": DASHES[number]}
            for panel, key in zip(axes, ("mechanisms", "fixed_steps"), strict=True):
                own = [row for row in result[key] if row["observer"] == name]
                shares = [100 * row["correct"] for row in own]
                panel.plot([row["threshold"] for row in own], shares, **look, markersize=4, label=name)
        errors = [100 * PAPER_ERRORS[key] for key in ("none", "1 JND", "2 JND", "4 JND")]
        axes[0].errorbar(
            list(PAPER), [100 * share for share in PAPER.values()], yerr=errors, fmt="D", color=VERMILION, capsize=3,
            markersize=4, zorder=5, label="the paper's people, s.e.",
        )  # fmt: skip
        for panel, unit in zip(axes, ("share of the force [JND]", "the same at every force [N]"), strict=True):
            mark_level(panel, 100 / 6, "chance" if panel is axes[1] else "")
            panel.set_xlabel(f"threshold: {unit}")
        axes[0].set_ylim(0, 102)
        axes[0].set_ylabel("correct orders [%]")
        axes[0].set_title("deadband alone fitted at 0 JND only; the others at 2 and 4 JND, too", fontsize=7.5)
        axes[1].set_title("a prediction of each", fontsize=7.5)
        figure.suptitle("SIMULATED: four observers who order three tissues", fontsize=9)
        legend(figure, axes[0], ncols=3)


if __name__ == "__main__":
    main()
