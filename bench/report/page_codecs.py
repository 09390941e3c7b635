"""The page's part on what codecs send and what that costs in error: rate_distortion.py's rows and averages."""

from collections import Counter
from collections.abc import Sequence

from page_markdown import Row, listed, number, picture, table

OURS = "adaptive-predictive"

SOURCES = {
    "tue_": "one-axis bilateral teleoperation, MIT licence, decimated to 1 kHz:"
    " <https://github.com/Ohara124c41/Haptics-Bilateral_Teleoperation-1DOF_Experiments>"
}
"""Where recordings come from whose names begin so."""


def signals(results: Row) -> list[str]:
    """Return what the codecs were tried on."""
    kinds = {"scene": "the paper's scene", "recorded": "recorded", "made": "made"}
    recorded = [row["name"] for row in results["signals"] if row["kind"] == "recorded"]
    sources = [
        f"{listed([name for name in recorded if name.startswith(prefix)])}: {source}."
        for prefix, source in SOURCES.items()
        if any(name.startswith(prefix) for name in recorded)
    ]
    return [
        table(
            ("signal", "kind", "length [s]", "samples", "axes", "peak [N]"),
            (
                (
                    row["name"],
                    kinds[row["kind"]],
                    f"{row['seconds']:.1f}",
                    f"{row['samples']:,}",
                    str(row["axes"]),
                    f"{row['peak_n']:.2f}",
                )
                for row in results["signals"]
            ),
        ),
        (
            "The paper's scene is felt by the scripted hand of so many seeds, and counts as one signal in every average."
            " Made signals come from `bench/measure/rate_distortion_signals.py`, each one thing a codec must live with. Recordings are"
            " not in the repository"
            f" (`make bench RECORDINGS=FILE:FORCE:POSITION`). {' '.join(sources)}"
        ).rstrip(),
        (
            "Nobody has felt any of this: that an error is not felt rests on Weber's law alone. The settings of the"
            f" codec of our own, `{OURS}`, were found on the paper's scene and on one-axis recordings; the other codecs run"
            " with those that `hapticnet codecs` lists. It is the made signals that say how far a lead carries, and *What is"
            " in the tuning*, below, how much of it is tuning."
        ),
    ]


def over_optimum(results: Row) -> list[str]:
    """Return packets over the optimum and bytes, for every codec on every signal."""
    return [
        (
            "Packets sent at 1 JND over the fewest that any zero-order hold could do with, all of the future known; what"
            f" does not hold can be below 1; on three axes that fewest is a lower bound. Without loss, float32 payloads, 1 kHz. {around(results)} Means over signals are"
            " arithmetic. Bold: the least of all codecs that never exceed 1 JND on that signal."
        ),
        matrix(results, "near_over_optimum", ".2f", 1.0),
        "The same runs in kB/s of forces on the wire, UDP and IPv4 headers included:",
        matrix(results, "near_wire_bytes_per_s", ".2f", 1e-3),
        (
            "A session also says that nothing has changed, each 45 ms without a force, so that a silent link can be told from a"
            " force that stands still: the fewer forces, the more of the bytes are these. Beside it, packets over the fewest"
            " straight lines, which is the measure for what extrapolates. Means at 1 JND."
        ),
        sessions(results),
        picture("rate_distortion.png", "packets and bytes against error, a point for each threshold"),
        (
            "*Packets (above) and bytes (below) against error on four signals, one or two of each kind, a point for each of the"
            f" thresholds {listed([f'{each:g}' for each in results['thresholds']])} JND. The fewest packets are drawn over the"
            " deadband's error at the same threshold; they are counts, with no error of their own.*"
        ),
    ]


def around(results: Row) -> str:
    """Say over which thresholds packets are averaged."""
    factors = sorted((1.0, *results["beside"]))
    if len(factors) == 1:
        return "Each figure is of that one threshold."
    return (
        f"Each figure is the mean over {len(factors)} thresholds from {factors[0]:g} to {factors[-1]:g} times the one named,"
        " since at a single one luck moves it by some per cent."
    )


def sessions(results: Row) -> str:
    """Return bytes with keepalives, and packets over the fewest lines, for each set of signals."""
    names = list(results["sets"])
    found = {name: {row["codec"]: row for row in averages(results, name, 1.0)} for name in names}
    codecs = [codec for codec in found[names[0]] if codec != "raw"]
    heads = (
        f"{what}: {name}" for name in names for what in ("kB/s", "with keepalives", "packets over the fewest lines")
    )
    return table(
        ("codec", *heads),
        (
            (
                codec,
                *(
                    cell
                    for name in names
                    for row in [found[name][codec]]
                    for cell in (
                        f"{row['wire_bytes_per_s'] / 1e3:.2f}",
                        f"{row['session_wire_bytes_per_s'] / 1e3:.2f}",
                        f"{row['over_lines']:.2f}",
                    )
                ),
            )
            for codec in codecs
        ),
    )


def matrix(results: Row, key: str, spec: str, factor: float) -> str:
    """Return a line for each codec, a column for each signal, and after each set of signals its average."""
    kinds = {row["name"]: row["kind"] for row in results["signals"]}
    block = [row for row in at(results["rows"], 1.0) if row["codec"] != "raw"]
    columns: list[tuple[str, dict[str, float], set[str]]] = []
    for name, members in results["sets"].items():
        inside = [trial for trial, kind in kinds.items() if kind in members]
        scenes = [trial for trial in inside if kinds[trial] == "scene"]
        groups = ([("paper's scene", scenes)] if scenes else []) + [
            (trial, [trial]) for trial in inside if trial not in scenes
        ]
        for heading, trials in groups:
            values, exceeding = {}, set()
            for codec in dict.fromkeys(row["codec"] for row in block):
                own = [row for row in block if row["codec"] == codec and row["trial"] in trials]
                values[codec] = sum(row[key] for row in own) / len(own)
                if any(row["exceed_jnd_fraction"] for row in own):
                    exceeding.add(codec)
            columns.append((heading, values, exceeding))
        means = {row["codec"]: row for row in averages(results, name, 1.0)}
        unsafe = {codec for codec, row in means.items() if row["largest_exceed_jnd_fraction"]}
        columns.append((f"*mean: {name}*", {codec: row[key] for codec, row in means.items()}, unsafe))
    lines = []
    for codec in dict.fromkeys(row["codec"] for row in block):
        cells = []
        for _, values, exceeding in columns:
            cell = format(factor * values[codec], spec)
            safe = {name: value for name, value in values.items() if name not in exceeding and name != "raw"}
            cells.append(f"**{cell}**" if codec in safe and values[codec] == min(safe.values()) else cell)
        lines.append((codec, *cells))
    return table(("codec", *(heading for heading, _, _ in columns)), lines)


def errors(results: Row) -> list[str]:
    """Return error, steps, age and energy of every codec at 1 JND."""
    aimed_at = next(iter(results["sets"]))
    rows = [row for row in averages(results, aimed_at, 1.0) if row["codec"] != "raw"]
    return [
        (
            f"At 1 JND without loss over {aimed_at}; formulae in [perception.md](perception.md). Means over the signals, but"
            " where the heading says largest or most: those are of any signal. Age: of the stimulus being applied, which is"
            " mostly how long the force stood still. Energy: what the reconstruction had created, the force held until the"
            " next sample."
        ),
        table(
            (
                "codec", "fewer packets", "above 1 JND", "RMSE [mN]", "largest error [N]", "PSNR [dB]", "HPW-PSNR [dB]",
                "perceptual MSE [JND²]", "age [ms]", "most packets in 100 ms", "most energy [mJ]",
            ),
            (
                (
                    row["codec"],
                    f"{row['packet_rate_reduction']:.1%}",
                    f"{row['exceed_jnd_fraction']:.2%}",
                    f"{1e3 * row['rmse_n']:.1f}",
                    f"{row['largest_max_error_n']:.2f}",
                    number(row["psnr_db"], ".1f"),
                    number(row["hpw_psnr_db"], ".1f"),
                    number(row["perceptual_mse"], ".2f"),
                    f"{row['age_mean_us'] / 1e3:.0f}",
                    f"{row['largest_worst_100ms_packets']}",
                    number(row["largest_energy_peak_j"], ".2f", 1e3),
                )
                for row in rows
            ),
        ),
        exceeding(results),
    ]  # fmt: skip


def exceeding(results: Row) -> str:
    """Say which codecs do not keep to one JND, and that it is by design where it is."""
    worst: dict[str, float] = {}
    for row in at(results["rows"], 1.0):
        worst[row["codec"]] = max(worst.get(row["codec"], 0.0), row["exceed_jnd_fraction"])
    found = [f"{codec} (up to {share:.1%} of the samples)" for codec, share in worst.items() if share]
    if not found:
        return "At a threshold of 1 JND no codec exceeds it at any sample of any signal."
    return (
        f"At a threshold of 1 JND the JND at rest is exceeded by {listed(found)}, and by no other codec at any sample of any"
        " signal. Velocity-adaptive, passive and merging codecs exceed it by design: the first counts on a hand in motion"
        " feeling less, the second shift the force by a threshold against the motion, the third waits. Where they do they"
        " are left out when the least is looked for."
    )


def winners(results: Row) -> list[str]:
    """Return who sends fewest packets and bytes on each signal, and where ours does not."""
    contest = results["contest"]
    thresholds = sorted({entry["multiplier"] for entry in contest})
    lines = [
        (
            entry["trial"],
            f"{entry['multiplier']:g}",
            entry["packets"]["codec"],
            f"{entry['packets']['of_deadband']:.2f}",
            f"{entry['packets']['over_optimum']:.2f}",
            named(entry["bytes"]),
            f"{entry['bytes']['of_deadband']:.2f}",
        )
        for entry in contest
        if entry["multiplier"] in (1.0, 4.0)
    ]
    tally = Counter(entry["packets"]["codec"] for entry in contest)
    counts = listed([f"{codec} on {times}" for codec, times in tally.most_common()])
    lost = [
        f"{entry['trial']} at {entry['multiplier']:g} JND ({packets['codec']}, {packets['value'] / ours_on(results, entry):.2f})"
        for entry in contest
        if OURS not in ((packets := entry["packets"])["codec"], entry["bytes"]["codec"])
    ]
    text = [
        (
            "Among the codecs that never exceed 1 JND on a signal when that is their threshold, with float32 and with"
            f" millinewton payloads; packets and bytes as shares of the deadband's with float32. {around(results)}"
        ),
        table(
            ("signal", "JND", "fewest packets", "of deadband's", "× optimum", "fewest bytes", "of deadband's"), lines
        ),
        (
            f"Fewest packets over all {len(contest)} pairs of signal and threshold"
            f" ({listed([f'{threshold:g}' for threshold in thresholds])} JND; the paper's scene with each hand): {counts}."
        ),
    ]
    if lost:
        text.append(
            f"Where `{OURS}` has the fewest neither of packets nor of bytes, with who has, and packets as a share of ours: {'; '.join(lost)}."
        )
    return text


def ours_on(results: Row, entry: Row) -> float:
    """Return packets of our codec with float32 payloads where a contest was."""
    return next(
        float(row["near_sent"])
        for row in at(results["rows"], entry["multiplier"])
        if row["codec"] == OURS and row["trial"] == entry["trial"]
    )


def at(rows: Sequence[Row], multiplier: float) -> list[Row]:
    """Return the rows at a threshold without loss, float32 payload."""
    return [row for row in rows if not row["loss"] and not row["step_n"] and row["multiplier"] == multiplier]


def averages(results: Row, signals: str, multiplier: float) -> list[Row]:
    """Return the averages over a set of signals at a threshold without loss, float32 payload."""
    return [row for row in at(results["averages"], multiplier) if row["signals"] == signals]


def named(entry: Row) -> str:
    """Return a codec with its payload format."""
    return f"{entry['codec']}, {1000 * entry['step_n']:g} mN" if entry["step_n"] else str(entry["codec"])
