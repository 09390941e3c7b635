"""The page's first table: what was aimed at, and whether this run reached it."""

from collections.abc import Callable, Sequence

from page_codecs import OURS, at, averages
from page_markdown import Row, listed, table
from page_nodes import BY_DESIGN, ROUNDING, worst_error

Target = tuple[str, str, str, bool]
"""What, the aim, what was measured, and whether that reaches it."""


def targets(records: dict[str, Row]) -> list[str]:
    """Return the table of targets of whatever was measured."""
    found = [target for name, of in OF.items() if name in records for target in of(records[name]["results"])]
    missed = sum(not reached for *_, reached in found)
    absent = [f"`bench/measure/{name}.py`" for name in OF if name not in records]
    text = [
        (
            f"What hapticnet aims at, and what this run reached: {missed} of {len(found)} are missed. The sections below have the"
            " figures behind each line."
        ),
        table(
            ("what", "aimed at", "measured", ""),
            ((what, aim, measured, "reached" if reached else "**missed**") for what, aim, measured, reached in found),
        ),
    ]
    return [*text, f"Not measured: what {listed(absent)} has targets for."] if absent else text


def rate_distortion(results: Row) -> list[Target]:
    """Return the targets of our codec, of zero exceedance, of published reductions and of entropy coding."""
    aimed_at, *others = results["sets"]
    kinds = {row["name"]: row["kind"] for row in results["signals"]}
    inside = {trial for trial, kind in kinds.items() if kind in results["sets"][aimed_at]}
    strict = [
        row
        for row in averages(results, aimed_at, 1.0)
        if row["codec"] != "raw" and not row["largest_exceed_jnd_fraction"]
    ]
    ours = next(row for row in averages(results, aimed_at, 1.0) if row["codec"] == OURS)
    plain = {
        (row["trial"], row["multiplier"]): row["near_sent"]
        for row in results["rows"]
        if row["codec"] == "deadband" and not row["loss"] and not row["step_n"]
    }
    of_deadband = [
        (row["near_sent"] / plain[row["trial"], row["multiplier"]], row["trial"], row["multiplier"])
        for row in results["rows"]
        if row["codec"] == OURS and not row["loss"] and not row["step_n"]
    ]
    worst, trial, multiplier = max(each for each in of_deadband if each[1] in inside)
    worst_made, made_trial, made_multiplier = max(each for each in of_deadband if each[1] not in inside)
    slowest_ns, slowest, slowest_on = max(
        (row["nanoseconds_per_sample"], row["codec"], f"{row['trial']}, {row['multiplier']:g} JND")
        for row in results["rows"]
        if not row["loss"] and not row["step_n"]
    )
    rival = min((row for row in strict if row["codec"] != OURS), key=lambda row: float(row["near_wire_bytes_per_s"]))
    exceeding = sorted(
        {row["codec"] for row in at(results["rows"], 1.0) if row["exceed_jnd_fraction"]} - set(BY_DESIGN)
    )
    savings = [row["saving"] for row in results["payloads"]]
    found = [
        (
            f"`{OURS}`: packets over the optimal hold, mean over {aimed_at}, 1 JND",
            "≤ 1.0",
            f"{ours['near_over_optimum']:.2f}",
            ours["near_over_optimum"] <= 1.0,
        ),
        (
            f"`{OURS}`: packets over the deadband's on each of these, any threshold",
            "≤ 1",
            f"{worst:.2f} at the worst ({trial}, {multiplier:g} JND)",
            worst <= 1.0,
        ),
        (
            f"`{OURS}`: packets over the deadband's on each made signal, any threshold",
            "≤ 1",
            f"{worst_made:.2f} at the worst ({made_trial}, {made_multiplier:g} JND)",
            worst_made <= 1.0,
        ),
        (
            f"`{OURS}`: wire bytes, mean over {aimed_at}, of those that keep to 1 JND",
            "fewest",
            f"{ours['near_wire_bytes_per_s'] / 1e3:.2f} kB/s; {rival['codec']} {rival['near_wire_bytes_per_s'] / 1e3:.2f}",
            ours["near_wire_bytes_per_s"] <= rival["near_wire_bytes_per_s"],
        ),
        *(
            (
                f"`{OURS}`: packets over the optimal hold, mean over {name}, 1 JND",
                "≤ 1.0",
                f"{made['near_over_optimum']:.2f}",
                made["near_over_optimum"] <= 1.0,
            )
            for name in others
            for made in averages(results, name, 1.0)
            if made["codec"] == OURS
        ),
        (
            "Codecs that are to keep to 1 JND: samples beyond it, all signals, no loss",
            "none",
            f"none, of {len({row['codec'] for row in at(results['rows'], 1.0)} - set(BY_DESIGN))} codecs"
            if not exceeding
            else ", ".join(exceeding),
            not exceeding,
        ),
        (
            "Any codec in a stream, encode and decode, every signal and threshold",
            "≤ 3 µs",
            f"{slowest_ns / 1e3:.1f} µs ({slowest} on {slowest_on})",
            slowest_ns <= 3000.0,
        ),
        (
            "Entropy-coded residuals: wire bytes saved of linear prediction's",
            "≥ 25 %",
            f"on {sum(saving >= 0.25 for saving in savings)} of {len(savings)} pairs of signal and threshold",
            min(savings) >= 0.25,
        ),
    ]
    for row in results["regimes"]:
        at_jnd = next(point["reduction"] for point in row["points"] if point["multiplier"] == 1.0)
        k = next(point["weber_fraction"] for point in row["points"] if point["multiplier"] == 1.0)
        found.append(
            (
                f"{row['codec']}: fewer packets on {row['trial']}, k = {k:.0%}",
                f"{row['published']:.0%} (published, at most)",
                f"{at_jnd:.1%}",
                at_jnd >= row["published"],
            )
        )
    return found


def codec_speed(results: Row) -> list[Target]:
    """Return the targets of speed."""
    arrays = [row["fast"] / row["c"] for row in results["rows"] if row["fast"]]
    kernels = [
        (row["fast"] / row["c"], row["codec"])
        for row in results["codecs"]
        if row["fast"] and row["c"] and row["codec"] != "deadband"
    ]
    scalar_ns = max(1e3 / row["stream"] for row in results["rows"])
    slowest_ns, slowest = max((max(row["walk_ns"], row["paper_ns"]), row["codec"]) for row in results["codecs"])
    swept = results["sweep"]["m_sample_parameters_per_s"]
    found = []
    if arrays:
        found.append(("Whole-array deadband over a plain C loop", "≥ 80 %", f"{min(arrays):.0%}", min(arrays) >= 0.8))
    if kernels:
        ratio, codec = min(kernels)
        found.append(
            (
                f"Other whole-array kernels over their C loops ({len(kernels)} codecs)",
                "≥ 50 %",
                f"{ratio:.0%} at the worst ({codec})",
                ratio >= 0.5,
            )
        )
    return [
        *found,
        ("Deadband in a stream, plain Python", "≤ 0.5 µs", f"{scalar_ns / 1e3:.3f} µs", scalar_ns <= 500.0),
        (
            "Any codec in a stream, a walk and the paper's scene",
            "≤ 3 µs",
            f"{slowest_ns / 1e3:.2f} µs ({slowest})",
            slowest_ns <= 3000.0,
        ),
        (
            f"A sweep of {results['sweep']['laws']} thresholds",
            "≥ 1,000 M/s",
            f"{swept:,.0f} M sample-parameters/s",
            swept >= 1000.0,
        ),
    ]


def codec_stability(results: Row) -> list[Target]:
    """Return the targets of numerical stability."""
    apart = sum(not row["in_step"] for row in results["signals"])
    drift = sum(row["times_out_of_step"] for row in results["long"])
    samples = sum(row["samples"] for row in results["long"])
    strict = {row["codec"] for row in results["signals"]} - set(BY_DESIGN)
    leaving = sorted(codec for codec in strict if worst_error(results, codec) > 1.0 + ROUNDING)
    return [
        (
            "Hard signals: codecs that are to keep to their threshold and leave it",
            "none",
            ", ".join(leaving) or f"none of {len(strict)}",
            not leaving,
        ),
        (
            "Hard signals after which encoder and decoder differ by a bit",
            "0",
            f"{apart} of {len(results['signals'])}",
            apart == 0,
        ),
        ("Long runs: times encoder and decoder were out of step", "0", f"{drift} in {samples:,} samples", drift == 0),
    ]


def force_loop(results: Row) -> list[Target]:
    """Return the targets of the fingertip's force loop, true forces."""
    fingers = {row["stiffness_n_m"]: row["true"] for row in results["step"]}

    def worst(figure: str) -> tuple[float, float]:
        return max(
            (true[figure]["worst"] if true[figure]["worst"] is not None else float("inf"), stiffness)
            for stiffness, true in fingers.items()
        )

    rise_s, soft = worst("rise_s")
    overshoot, hard = worst("overshoot")
    settling_s, slow = worst("settling_s")
    return [
        (
            "Force step: 10–90 % rise, every finger",
            "≤ 200 ms",
            f"{1e3 * rise_s:.0f} ms ({soft / 1e3:g} N/mm)",
            rise_s <= 0.2,
        ),
        ("Force step: overshoot, every finger", "≤ 5 %", f"{overshoot:.1%} ({hard / 1e3:g} N/mm)", overshoot <= 0.05),
        (
            "Force step: settling to 5 %, every finger",
            "≤ 350 ms",
            f"{1e3 * settling_s:.0f} ms ({slow / 1e3:g} N/mm)"
            if settling_s < float("inf")
            else f"never ({slow / 1e3:g} N/mm)",
            settling_s <= 0.35,
        ),
    ]


OF: dict[str, Callable[[Row], Sequence[Target]]] = {
    "rate_distortion": rate_distortion,
    "codec_speed": codec_speed,
    "codec_stability": codec_stability,
    "force_loop": force_loop,
}
