"""The page's part on steps, loss, published reductions and entropy coding: the rest of rate_distortion.py's results."""

from page_codecs import OURS, averages
from page_markdown import Row, picture, span, table


def steps(results: Row) -> list[str]:
    """Return the steps a person feels, and what it costs to bound them."""
    rows = results["steps"]
    free = next(row for row in rows if row["codec"] == OURS and not row["bound"])
    plain = next(row for row in rows if row["codec"] == "deadband")
    return [
        (
            "Two stimuli more than a JND apart can be told apart, so that the change of the applied force when an update"
            " arrives, in JNDs of what was applied before, may be felt as a step. At 1 JND, over"
            f" {next(iter(results['sets']))}: means over the signals, and the largest of any. The largest steps of the paper's"
            " scene are in the signal itself: a breach lets go of it all. `jump_thresholds` of our codec bounds the others."
        ),
        table(
            ("codec", "`jump_thresholds`", "packets over the optimum", "mean jump [JND]", "99.9 % below [JND]",
             "largest [JND]"),
            (
                (
                    row["codec"],
                    "–" if row["bound"] is None else f"{row['bound']:g}" if row["bound"] else "0 (free)",
                    f"{row['over_optimum']:.2f}",
                    f"{row['jump_mean_jnd']:.2f}",
                    f"{row['jump_p999_jnd']:.1f}",
                    f"{row['jump_max_jnd']:.1f}",
                )
                for row in rows
            ),
        ),
        (
            f"Left free, `{OURS}` jumps by {free['jump_mean_jnd']:.2f} JND in the mean,"
            f" {free['jump_mean_jnd'] / plain['jump_mean_jnd']:.2f} times as far as the deadband, and sends"
            f" {free['over_optimum'] / plain['over_optimum']:.2f} times as many packets."
        ),
    ]  # fmt: skip


def losses(results: Row) -> list[str]:
    """Return exceedance, error and packets over loss."""
    aimed_at = next(iter(results["sets"]))
    rates = list(dict.fromkeys(row["loss"] for row in results["rows"]))
    lines = []
    for codec in dict.fromkeys(row["codec"] for row in results["averages"]):
        own = {
            row["loss"]: row
            for row in results["averages"]
            if (row["signals"], row["codec"], row["step_n"], row["multiplier"]) == (aimed_at, codec, 0.0, 1.0)
        }
        if len(own) == len(rates):
            lines.append(
                (
                    codec,
                    *(f"{own[loss]['exceed_jnd_fraction']:.1%}" for loss in rates),
                    *(f"{1e3 * own[loss]['rmse_n']:.0f}" for loss in rates),
                    *(f"{own[loss]['largest_max_error_n']:.1f}" for loss in rates),
                    *(f"{own[loss]['packets_per_s']:.0f}" for loss in rates),
                )
            )
    heads = (
        f"{what}, {loss:.0%} lost"
        for what in ("above 1 JND", "RMSE [mN]", "largest error [N]", "packets/s")
        for loss in rates
    )
    return [
        (
            f"Updates lost at random, each replaced by the present stimulus {results['repair_us'] / 1000:g} ms later, if that"
            f" is not lost in turn; 1 JND, float32 payloads, means over {aimed_at}, each over {results['loss_seeds']} channels"
            " that lose; the largest error is of all of them. A predictor that misses the end of a slope follows it to its"
            " horizon, and so may be off by more than the force itself. Delay and jitter are not in it."
        ),
        table(("codec", *heads), lines),
    ]


def regimes(results: Row) -> list[str]:
    """Return what of the published reductions is reached on a force of that scale, and why not more."""
    text = [
        (
            "The largest reductions of the packet rate that the papers report, beside ours on forces of that scale, over the"
            " Weber fraction k; the last column is the smallest k tried at which the published figure is reached."
        )
    ]
    for trial in dict.fromkeys(row["trial"] for row in results["regimes"]):
        rows = [row for row in results["regimes"] if row["trial"] == trial]
        shown = [point["weber_fraction"] for point in rows[0]["points"] if point["multiplier"] in (1.0, 2.0, 4.0)]
        lines = []
        for row in rows:
            reached = {point["weber_fraction"]: point["reduction"] for point in row["points"]}
            lines.append(
                (
                    row["codec"],
                    f"{row['published']:.0%}",
                    *(f"{reached[k]:.1%}" for k in shown),
                    f"{100 * (reached[shown[0]] - row['published']):+.1f}",
                    "not reached" if row["reached_at"] is None else f"{row['reached_at']:.1%}",
                )
            )
        first = rows[0]
        optimum = next(p["optimum_reduction"] for p in first["points"] if p["multiplier"] == 1.0)
        moving = (
            f"The hand moves at {1000 * first['mean_speed_m_per_s']:.0f} mm/s in the mean, and the velocity-adaptive deadband,"
            " whose gain is an assumption, widens by what that allows."
            if first["has_position"]
            else "Without positions velocity-adaptive and passive codecs are plain deadbands."
        )
        text += [
            f"{trial} ({first['peak_n']:.1f} N peak, {first['samples_per_s']:.0f} samples/s):",
            table(
                (
                    "codec",
                    "published",
                    *(f"k = {k:.0%}" for k in shown),
                    f"points off at k = {shown[0]:.0%}",
                    "reached at k",
                ),
                lines,
            ),
            (
                f"Why they differ: a reduction says as much of the signal as of the codec. This force travels"
                f" {first['jnds_per_s']:.0f} JNDs (k = {shown[0]:.0%}) a second, and the best possible hold reaches {optimum:.1%}"
                f" there; 96 % at this sampling rate leaves {0.04 * first['samples_per_s']:.0f} packets/s, 89 %"
                f" {0.11 * first['samples_per_s']:.0f}. {moving} The passive codecs send what the deadband sends; what they shift"
                " costs error, not packets."
            ),
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
        if row["multiplier"] == 1.0
    ]
    reached = sum(row["saving"] >= 0.25 for row in rows)
    axes_of = {row["name"]: row["axes"] for row in results["signals"]}
    verdicts = []
    for axes in sorted(set(axes_of.values())):
        own = [row for row in rows if axes_of[row["trial"]] == axes]
        bounds = [row["largest_payload_saving"] for row in own]
        verdicts.append(
            f"On {axes} {'axis' if axes == 1 else 'axes'} no coding of the payload can save more than"
            f" {span(bounds, '.0%')}, packet for packet, and this one saves"
            f" {span([row['payload_saving'] for row in own], '.0%')}"
            + (": there the headers forbid it." if max(bounds) < 0.25 else ".")
        )
    return [
        (
            "Least-squares prediction with Golomb–Rice coded residuals beside linear prediction with float32 payloads, both"
            " at zero exceedance of their threshold. Payload: what the smaller payload saves of the wire bytes if as many"
            " packets are sent; bound: what an empty payload would save. Negative: more. The last column is our codec with payloads of whole millinewtons."
        ),
        table(
            ("signal", "JND", "payload [B]", "headers [B]", "payload", "bound", "fewer packets", "fewer wire bytes",
             f"{OURS}, 1 mN"),
            lines,
        ),
        (
            f"At least 25 % fewer wire bytes were aimed at. That is reached on {reached} of {len(rows)} pairs of signal and"
            f" threshold. There are {span([row['float32']['headers_per_packet'] for row in rows], '.0f')} B of headers around each"
            f" payload. {' '.join(verdicts)} The rest comes from the prediction, as packets."
        ),
    ]  # fmt: skip


def cost(results: Row) -> list[str]:
    """Return time per sample against error."""
    times = [
        row["nanoseconds_per_sample"]
        for name in results["sets"]
        for row in averages(results, name, 1.0)
        if row["codec"] != "raw"
    ]
    return [
        picture("codec_cost.png", "time for a sample against error"),
        (
            f"*Encoding and decoding in a stream, plain Python, took {span(times, '.1f', 1e-3)} µs per sample in the mean over"
            " a set of signals; the time grows with the number of updates. Codec speed, below, has the clean figures.*"
        ),
    ]
