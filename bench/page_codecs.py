"""The page's part on codecs: what rate_distortion.py measured."""

from collections import Counter
from collections.abc import Sequence

from page_markdown import Row, listed, number, picture, span, table

OURS = "adaptive-predictive"


def rate_distortion(results: Row) -> list[str]:
    """Return the section on packets, bytes and error of every codec."""
    multiplier = 1.0
    return [
        "Signals:",
        signals(results),
        (
            "`paper's scene N` is the scene and scripted hand of seed N; the next ones are made by"
            " `bench/rate_distortion_signals.py` from a seed; any others are recordings. An average counts the paper's"
            " scene once. Nothing here is a person's judgement: that the errors are not felt rests on the law alone."
        ),
        "### Packets over the optimum",
        (
            f"Packets sent at {multiplier:g} JND over the fewest that any zero-order hold could do with, all of the future"
            " known (below 1 is possible for what does not hold). Without loss, float32 payload."
        ),
        matrix(results, "over_optimum", ".2f", 1.0, multiplier),
        "### Wire bytes",
        "kB/s with UDP and IPv4 headers, same runs.",
        matrix(results, "wire_bytes_per_s", ".2f", 1e-3, multiplier),
        picture("rate_distortion.png", "packets and bytes against error, a point for each threshold"),
        (
            "*Packets (above) and bytes (below) against error, a point for each threshold. The optima are drawn over the"
            " deadband's error at the same threshold; they are counts of packets, with no error of their own.*"
        ),
        "### Error, steps and energy",
        (
            "Means over the signals, without loss; one JND is one JND whatever the threshold, so that above 1 JND"
            " exceedance is by design. Jump: change of the applied force when an update arrives. Energy: the most the"
            " reconstruction had created on any signal, the force held until the next sample."
        ),
        errors(results),
        exceeding(results),
        "### What wins where",
        *winners(results),
        "### Loss",
        (
            f"Updates lost at random, each replaced after {results['repair_us'] / 1000:g} ms; {multiplier:g} JND, float32"
            " payload; means over the signals."
        ),
        losses(results, multiplier),
        "### Published reductions",
        *regimes(results),
        "### Entropy-coded payload",
        *payloads(results),
        "### Cost",
        picture("codec_cost.png", "time for a sample against error"),
        (
            f"*Encoding and decoding in a stream took {span(times(results), '.1f', 1e-3)} µs per sample in the mean over"
            " the signals, on a machine that may have had other work: compare codecs with each other. The clean figures are"
            " those of codec speed below.*"
        ),
    ]


def signals(results: Row) -> str:
    """Return what the codecs were tried on."""
    return table(
        ("signal", "length [s]", "samples", "axes", "peak [N]"),
        (
            (row["name"], f"{row['seconds']:.1f}", f"{row['samples']:,}", str(row["axes"]), f"{row['peak_n']:.2f}")
            for row in results["signals"]
        ),
    )


def matrix(results: Row, key: str, spec: str, factor: float, multiplier: float) -> str:
    """Return a line for each codec and a column for each signal, the best codec that keeps its threshold in bold."""
    block = [row for row in at(results["rows"], multiplier) if row["codec"] != "raw"]
    trials = list(dict.fromkeys(row["trial"] for row in block))
    least = {
        trial: min(row[key] for row in block if row["trial"] == trial and row["exceed_jnd_fraction"] == 0.0)
        for trial in trials
    }
    means = {row["codec"]: row[key] for row in at(results["averages"], multiplier)}
    lines = []
    for codec in dict.fromkeys(row["codec"] for row in block):
        cells = []
        for row in (row for row in block if row["codec"] == codec):
            cell = format(factor * row[key], spec)
            best = row[key] == least[row["trial"]] and row["exceed_jnd_fraction"] == 0.0
            cells.append(f"**{cell}**" if best else cell)
        lines.append((codec, *cells, format(factor * means[codec], spec)))
    return table(("codec", *trials, "average"), lines)


def errors(results: Row) -> str:
    """Return error, steps and energy for each threshold and codec."""
    return table(
        ("codec", "JND", "fewer packets", "above 1 JND", "RMSE [N]", "mean jump [JND]", "largest [JND]", "energy [mJ]"),
        (
            (
                row["codec"],
                f"{row['multiplier']:g}",
                f"{row['packet_rate_reduction']:.1%}",
                f"{row['exceed_jnd_fraction']:.2%}",
                f"{row['rmse_n']:.4f}",
                f"{row['send_jump_mean_jnd']:.1f}",
                number(row["largest_send_jump_max_jnd"], ".0f"),
                number(row["largest_energy_peak_j"], ".2f", 1e3),
            )
            for row in results["averages"]
            if not row["loss"] and not row["step_n"] and row["codec"] != "raw"
        ),
    )


def exceeding(results: Row) -> str:
    """Say which codecs do not keep to one JND, and that it is by design where it is."""
    found = [
        f"{row['codec']} ({row['exceed_jnd_fraction']:.1%})"
        for row in at(results["averages"], 1.0)
        if row["largest_exceed_jnd_fraction"] > 0.0
    ]
    if not found:
        return "At a threshold of 1 JND no codec exceeds it anywhere."
    return (
        f"At a threshold of 1 JND the JND at rest is exceeded by {listed(found)}, and by no other codec at any sample."
        " Velocity-adaptive, passive and merging codecs exceed it by design: the first counts on a hand in motion"
        " feeling less, the second shift the force by a threshold, the third waits. They are not compared with the rest"
        " in what follows."
    )


def winners(results: Row) -> list[str]:
    """Return who sends fewest packets and bytes at each threshold, and where ours does not."""
    lines = []
    lost = []
    for entry in results["contest"]:
        packets, size = entry["packets"], entry["bytes"]
        if OURS not in (packets["codec"], size["codec"]):
            lost.append((entry["multiplier"], entry["trial"], packets, size))
        lines.append(
            (
                entry["trial"],
                f"{entry['multiplier']:g}",
                packets["codec"],
                f"{packets['of_deadband']:.2f}",
                f"{packets['over_optimum']:.2f}",
                named(size),
                f"{size['of_deadband']:.2f}",
            )
        )
    tally = Counter(entry["packets"]["codec"] for entry in results["contest"])
    counts = listed([f"{codec} on {times} of {len(lines)}" for codec, times in tally.most_common()])
    plain = {(row["trial"], row["multiplier"]): row["sent"] for row in lossless(results, "deadband")}
    worst = max(
        (row["sent"] / max(plain[row["trial"], row["multiplier"]], 1), row["trial"], row["multiplier"])
        for row in lossless(results, OURS)
    )
    strict = [row for row in at(results["averages"], 1.0) if row["largest_exceed_jnd_fraction"] == 0.0]
    best = min((row for row in strict if row["codec"] != "raw"), key=lambda row: row["over_optimum"])
    smallest = min((row for row in strict if row["codec"] != "raw"), key=lambda row: row["wire_bytes_per_s"])
    mean = next(row for row in strict if row["codec"] == OURS)
    goal = "reached" if mean["over_optimum"] <= 1.0 else "missed on these signals"
    text = [
        "Among the codecs that keep to the threshold, with every payload format:",
        table(
            ("signal", "JND", "fewest packets", "of deadband's", "× optimum", "fewest bytes", "of deadband's"), lines
        ),
        (
            f"Fewest packets: {counts} pairs of signal and threshold. At 1 JND {best['codec']} is best in the average, with"
            f" {best['over_optimum']:.2f} × the optimum, and {smallest['codec']} in bytes, with"
            f" {smallest['wire_bytes_per_s'] / 1000:.2f} kB/s. The codec of our own, {OURS}, was to need no more than 1.0 ×"
            f" the optimum in the average over recordings and the paper's scene, and never more than the deadband: the"
            f" first is {goal} ({mean['over_optimum']:.2f} over all signals); at its worst it sends {worst[0]:.2f} × the"
            f" deadband's packets ({worst[1]}, {worst[2]:g} JND)."
        ),
    ]
    if lost:
        where = [
            f"{trial} at {multiplier:g} JND ({packets['codec']}, {packets['of_deadband']:.2f} of the deadband's packets)"
            for multiplier, trial, packets, _ in lost
        ]
        text.append(f"Where it wins neither packets nor bytes: {'; '.join(where)}.")
    return text


def losses(results: Row, multiplier: float) -> str:
    """Return exceedance and packets over loss."""
    rates = list(dict.fromkeys(row["loss"] for row in results["rows"]))
    lines = []
    for codec in dict.fromkeys(row["codec"] for row in results["averages"]):
        own = {
            row["loss"]: row
            for row in results["averages"]
            if row["codec"] == codec and not row["step_n"] and row["multiplier"] == multiplier
        }
        if len(own) == len(rates):
            lines.append(
                (
                    codec,
                    *(f"{own[loss]['exceed_jnd_fraction']:.1%}" for loss in rates),
                    *(f"{own[loss]['rmse_n']:.3f}" for loss in rates),
                    *(f"{own[loss]['packets_per_s']:.0f}" for loss in rates),
                )
            )
    heads = (f"{what}, {loss:.0%} lost" for what in ("above JND", "RMSE [N]", "packets/s") for loss in rates)
    return table(("codec", *heads), lines)


def regimes(results: Row) -> list[str]:
    """Return what of the published reductions is reached on a force of that scale, and why not more."""
    text = [
        (
            "Largest reductions of the packet rate that the papers report, beside ours on forces of that scale. Weber"
            " fractions k; the smallest tried k at which the published figure is reached."
        )
    ]
    for trial in dict.fromkeys(row["trial"] for row in results["regimes"]):
        rows = [row for row in results["regimes"] if row["trial"] == trial]
        shown = [point["weber_fraction"] for point in rows[0]["points"] if point["multiplier"] in (1.0, 2.0, 4.0)]
        lines = []
        for row in rows:
            reached = {point["weber_fraction"]: point["reduction"] for point in row["points"]}
            off = reached[shown[0]] - row["published"]
            lines.append(
                (
                    row["codec"],
                    f"{row['published']:.0%}",
                    *(f"{reached[k]:.1%}" for k in shown),
                    f"{100 * off:+.1f}",
                    "not reached" if row["reached_at"] is None else f"k = {row['reached_at']:.1%}",
                )
            )
        first = rows[0]
        optimum = next(p["optimum_reduction"] for p in first["points"] if p["multiplier"] == 1.0)
        text += [
            f"{trial} ({first['peak_n']:.1f} N peak, {first['samples_per_s']:.0f} samples/s):",
            table(
                ("codec", "published", *(f"k = {k:.0%}" for k in shown), f"points off at k = {shown[0]:.0%}", "at"),
                lines,
            ),
            f"Why they differ: a reduction says as much of the signal as of the codec. This force travels"
            f" {first['jnds_per_s']:.0f} JNDs (k = {shown[0]:.0%}) a second, and the best possible hold reaches"
            f" {optimum:.1%} there; 96 % at this sampling rate leaves {0.04 * first['samples_per_s']:.0f} packets/s,"
            f" 89 % {0.11 * first['samples_per_s']:.0f}. "
            + (
                f"The hand's mean speed is {1000 * first['mean_speed_m_per_s']:.0f} mm/s, so that the velocity-adaptive"
                " deadband, whose gain is an assumption, widens as much as that speed lets it."
                if first["has_position"]
                else "Without positions velocity-adaptive and passive codecs are plain deadbands."
            )
            + " The passive codecs send as the deadband does; what they shift costs error, not packets.",
        ]
    return text


def payloads(results: Row) -> list[str]:
    """Return what entropy coding saves, split into packets and payload."""
    rows = results["payloads"]
    lines = [
        (
            row["trial"],
            f"{row['multiplier']:g}",
            f"{row['float32']['payload_per_packet']:.1f} → {row['coded']['payload_per_packet']:.1f}",
            f"{row['float32']['headers_per_packet']:.1f}",
            f"{row['payload_saving']:.1%}",
            f"{row['largest_payload_saving']:.1%}",
            f"{row['fewer_packets']:.1%}",
            f"{row['saving']:.1%}",
            f"{row['ours_saving']:.1%}",
        )
        for row in rows
    ]
    reached = [row for row in rows if row["saving"] >= 0.25]
    largest = [row["largest_payload_saving"] for row in rows]
    verdict = (
        "Headers forbid it: packet for packet not even an empty payload saves 25 %."
        if max(largest) < 0.25
        else "Packet for packet an empty payload could save 25 % on some."
    )
    return [
        (
            "Least-squares prediction with Golomb–Rice coded residuals beside linear prediction in float32, both at zero"
            " exceedance of their threshold. Payload: what the smaller payload saves if as many packets are sent; bound:"
            " what an empty payload would. Negative is more. The last column is our codec with millinewton payloads."
        ),
        table(
            ("signal", "JND", "payload [B]", "headers [B]", "payload", "bound", "packets", "wire bytes", OURS),
            lines,
        ),
        (
            f"Target: at least 25 % fewer wire bytes. It is reached on {len(reached)} of {len(rows)} pairs. With"
            f" {span([row['float32']['headers_per_packet'] for row in rows], '.0f')} B of headers around each payload the"
            f" bound for any payload coding is {span(largest, '.0%')}, and the coding reaches"
            f" {span([row['payload_saving'] for row in rows], '.0%')}. {verdict} What is saved or lost beyond that comes"
            " from the prediction, as packets."
        ),
    ]


def at(rows: Sequence[Row], multiplier: float) -> list[Row]:
    """Return the rows at a threshold without loss, float32 payload."""
    return [row for row in rows if not row["loss"] and not row["step_n"] and row["multiplier"] == multiplier]


def lossless(results: Row, codec: str) -> list[Row]:
    """Return the rows of a codec at every threshold without loss, float32 payload."""
    return [row for row in results["rows"] if row["codec"] == codec and not row["loss"] and not row["step_n"]]


def times(results: Row) -> list[float]:
    """Return nanoseconds per sample of every codec but raw at 1 JND, mean over the signals."""
    return [row["nanoseconds_per_sample"] for row in at(results["averages"], 1.0) if row["codec"] != "raw"]


def named(entry: Row) -> str:
    """Return a codec with its payload format."""
    return f"{entry['codec']}, {1000 * entry['step_n']:g} mN" if entry["step_n"] else str(entry["codec"])
