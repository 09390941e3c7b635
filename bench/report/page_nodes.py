"""The page's parts on the paper's figure, stability, the scene and the fingertip."""

from page_markdown import Row, listed, number, picture, span, table

BY_DESIGN = ("velocity-adaptive", "passive-extrapolative", "passive-interpolative", "merging")
"""Codecs that exceed a JND on purpose; see the docstring of each."""

ROUNDING = 1e-9
"""What is computed here in another order than the codec has it may be beyond by a rounding."""


def packet_rate(results: Row) -> list[str]:
    """Return where on the curve over the sampling rate the paper's saving falls."""
    paper = results["paper_byte_reduction"]
    motion_s = results["motion"]["push_s"]
    curve = next(each for each in results["over_speeds"] if each["push_s"] == motion_s)
    seeds = [rate_hz for rate_hz in results["crossing_hz_of_seeds"] if rate_hz]
    where = "is not reached at any rate" if curve["crossing_hz"] is None else f"falls at {curve['crossing_hz']:.0f} Hz"
    spread = f" ({span(seeds, '.0f')} Hz from seed to seed)" if seeds else ""
    shown = [row for row in results["scene"] if row["condition"] != "none"]
    off = max(abs(row["packets_difference"]) for row in results["check"])
    return [
        (
            f"The paper saves {paper:.1%} of the bytes per penetration at 1 JND and states neither sampling rate nor"
            f" motion. With the scripted motion that figure {where}{spread}. This neither confirms nor refutes it; nothing"
            " was tuned to meet it."
        ),
        picture("packet_rate.png", "saving over the sampling rate, and over the error"),
        table(
            ("rate [Hz]", "condition", "bytes/penetration", "fewer bytes", "fewer packets", "RMSE [N]", "above JND"),
            (
                (
                    f"{row['rate_hz']:.0f}",
                    row["condition"],
                    f"{row['bytes_per_penetration_mean']:,.0f}",
                    f"{row['byte_reduction']:.1%}",
                    f"{row['packet_rate_reduction']:.1%}",
                    f"{row['rmse_n']:.4f}",
                    f"{row['exceed_jnd_fraction']:.1%}",
                )
                for row in shown
            ),
        ),
        f"Both nodes in virtual time over a perfect channel differ from this computation by {off} packets at most.",
    ]


def codec_stability(results: Row) -> list[str]:
    """Return the largest errors on hard signals, recovery from loss, and the long runs."""
    codecs = list(dict.fromkeys(row["codec"] for row in results["signals"]))
    beyond = {codec for codec in codecs if worst_error(results, codec) > 1.0 + ROUNDING}
    rows = [row for row in results["signals"] if row["law"] == "floor"]
    lines = []
    for signal in dict.fromkeys(row["signal"] for row in rows):
        own = {row["codec"]: row["max_error_thresholds"] for row in rows if row["signal"] == signal}
        lines.append((signal, *(format(own[codec], ".3g") for codec in codecs)))
    astray = sorted({f"{row['codec']} ({row['signal']})" for row in results["signals"] if not row["in_step"]})
    losses = [loss for loss in dict.fromkeys(row["loss"] for row in results["loss"]) if loss]
    lost = {(row["codec"], row["loss"]): row for row in results["loss"]}
    by_design = sorted(beyond & set(BY_DESIGN))
    failing = sorted(beyond - set(BY_DESIGN))
    text = [
        (
            "The largest distance of the applied stimulus from the true one at any sample, in thresholds around the applied one;"
            f" 1 is the threshold. {listed([codec for codec in codecs if codec not in beyond])} never leave it, with or without"
            " a floor of Weber's law."
        )
    ]
    if by_design:
        text.append(
            f"{listed(by_design)} do, by design: they widen it in motion, shift the force against the motion, lead up to a"
            " change along a ramp, or wait for a window to end; on signals that leap, by as much as the leap."
        )
    if failing:
        text.append(f"**{listed(failing)} do, and should not.**")
    return [
        *text,
        table(("signal", *codecs), lines),
        "Encoder and decoder agreed to the bit at the end of every signal."
        if not astray
        else f"Encoder and decoder did not agree at the end: {listed(astray)}.",
        (
            f"Loss on the paper's scene, {listed([f'{loss:.0%}' for loss in losses])} of the updates, each replaced as above."
            " Recovery: from a lost update to the next one taken in. An update lost at a breach leaves an error of the whole"
            " force until then."
        ),
        table(
            ("codec", *(f"{what}, {loss:.0%} lost" for what in ("above 1 JND", "largest error [N]", "longest recovery [ms]")
                        for loss in losses)),
            (
                (
                    codec,
                    *(f"{lost[codec, loss]['exceed_jnd_fraction']:.1%}" for loss in losses),
                    *(f"{lost[codec, loss]['max_error_n']:.2f}" for loss in losses),
                    *(f"{lost[codec, loss]['recovery_ms_max']:.0f}" for loss in losses),
                )
                for codec in codecs
            ),
        ),
        (
            "Long runs: samples beyond the threshold, and how often encoder and decoder were found out of step, looked at after"
            " every hundred thousand samples. `bench/measure/codec_stability.py --seconds` says how long each codec streams, up to"
            " 10⁸ samples."
        ),
        table(
            ("codec", "way", "samples", "packets", "beyond", "out of step"),
            (
                (
                    row["codec"],
                    row["way"],
                    *(f"{row[key]:,}" for key in ("samples", "packets", "samples_exceeding", "times_out_of_step")),
                )
                for row in results["long"]
            ),
        ),
    ]  # fmt: skip


def worst_error(results: Row, codec: str) -> float:
    """Return the largest error of a codec on any hard signal, in thresholds."""
    return max(float(row["max_error_thresholds"]) for row in results["signals"] if row["codec"] == codec)


def scene_accuracy(results: Row) -> list[str]:
    """Return error and cost of the scene over its rate."""
    forces = results["forces"]
    laws = list(dict.fromkeys(row["law"] for row in forces))
    rates_hz = list(dict.fromkeys(row["rate_hz"] for row in forces))
    held = {(row["law"], row["rate_hz"]): row for row in forces}
    breaches = {row["rate_hz"]: row for row in results["breaches"]}
    cost = {row["rate_hz"]: row for row in results["cost"]}
    largest_n = max(row["largest_force_n"] for row in results["breaches"])
    exact = [law for law in laws if max(held[law, rate_hz]["max_at_samples_n"] for rate_hz in rates_hz) < 1e-9]
    late = max(row["late_max_ms"] * row["rate_hz"] / 1000.0 for row in results["breaches"])
    return [
        ("A needle whose motion is known presses one layer; the scene's force, held until its next sample, beside the"
        f" exact force (steepest rise {results['steepest_n_per_s']:.1f} N/s for the linear spring)."),
        table(
            ("rate [Hz]", *(f"{law}: RMSE, largest [N]" for law in laws), "breach late, mean, largest [ms]",
             "surface off, largest [mm]", "cost [µs per s]"),
            (
                (
                    f"{rate_hz:,}",
                    *(
                        f"{held[law, rate_hz]['rmse_held_n']:.4f}, {held[law, rate_hz]['max_held_n']:.4f}"
                        for law in laws
                    ),
                    f"{breaches[rate_hz]['late_mean_ms']:.3f}, {breaches[rate_hz]['late_max_ms']:.3f}",
                    f"{1e3 * breaches[rate_hz]['surface_max_error_m']:.4f}",
                    f"{cost[rate_hz]['ns_per_second_best'] / 1000:,.0f}",
                )
                for rate_hz in rates_hz
            ),
        ),
        picture("scene_accuracy.png", "error of the force, lateness of a breach, and cost, over the rate of the scene"),
        (f"At the samples themselves {listed(exact)} are exact to rounding at every rate: laws are evaluated in closed"
        " form, not integrated. What is left is the hold, which falls with the period. A damper takes its velocity from"
        " two positions and so is half a period old, and it sets in with a step at contact, which a sample can miss by"
        " up to a period: its largest error need not fall with the rate, its RMSE does."),
        (f"Over {results['trials']} breaches at drawn speeds and phases, each was noticed at most {late:.2f} periods"
        f" late, and no force above {largest_n:.3f} N was given where the layer breaks at"
        f" {results['breach_force_n']:g} N. A surface that recovers (time constant {1000 * results['recovery_s']:g} ms)"
        " is evaluated from its release: its error is that lateness and no more."),
    ]  # fmt: skip


def force_loop(results: Row) -> list[str]:
    """Return what the fingertip's force loop does on a step, over control rates, and its largest forces."""
    figures = (("rise_s", 1e3, ".0f"), ("settling_s", 1e3, ".0f"), ("overshoot", 100.0, ".1f"),
               ("steady_error_n", 1e3, ".0f"), ("ripple_peak_to_peak_n", 1e3, ".0f"))  # fmt: skip
    fingers = list(dict.fromkeys(row["stiffness_n_m"] for row in results["largest"]))
    scenarios = list(dict.fromkeys(row["scenario"] for row in results["largest"]))
    rest = sum(row["at_rest"] for row in results["largest"])
    return [
        (
            f"A step of the target on fingers of different stiffness, nothing retuned, on the device `{results['device']}`:"
            " the true force, median / worst over the seeds."
        ),
        table(
            ("finger", "rise [ms]", "settling [ms]", "overshoot [%]", "steady error [mN]", "ripple [mN]"),
            (
                (
                    f"{row['stiffness_n_m'] / 1000:g} N/mm",
                    *(
                        " / ".join(number(row["true"][name][which], spec, factor) for which in ("median", "worst"))
                        for name, factor, spec in figures
                    ),
                )
                for row in results["step"]
            ),
        ),
        picture("force_loop.png", "the step on each finger, and settling and ripple over the control rate"),
        "Largest true force [N] over delays and losses:",
        table(
            ("scenario", *(f"{stiffness / 1000:g} N/mm" for stiffness in fingers)),
            (
                (
                    scenario,
                    *(
                        format(
                            max(
                                row["max_n"]
                                for row in results["largest"]
                                if (row["scenario"], row["stiffness_n_m"]) == (scenario, stiffness)
                            ),
                            ".2f",
                        )
                        for stiffness in fingers
                    ),
                )
                for scenario in scenarios
            ),
        ),
        f"The finger was at rest at the end of {rest} of {len(results['largest'])} runs.",
    ]
