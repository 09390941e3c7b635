"""The page's parts on time: of codecs beside plain C loops, of the scene, of both nodes, and of the real-time loop."""

from page_markdown import Row, listed, table


def codec_speed(results: Row) -> list[str]:
    """Return speeds of the deadband, of every codec, and of a sweep, beside the C loops."""
    rows = results["rows"]
    codecs = results["codecs"]
    slower = [row["codec"] for row in codecs if not row["c"] and row["codec"] != "raw"]  # which numpy packs
    return [
        (
            f"The scalar deadband over {results['samples']:,} samples, Msamples/s, best of the repetitions, in turns with"
            " a plain C loop (`bench/peers`, gcc -O3 -march=native)."
        ),
        table(
            ("updates sent", "C loop", "`fast` extra", "of C", "plain Python", "streaming"),
            (
                (
                    f"{row['sent']:.1%}",
                    f"{row['c']:.0f}",
                    f"{row['fast']:.0f}" if row["fast"] else "–",
                    f"{row['fast'] / row['c']:.0%}" if row["fast"] else "–",
                    f"{row['plain']:.1f}",
                    f"{row['stream']:.2f}",
                )
                for row in rows
            ),
        ),
        (
            "Every codec: encoding and decoding in a stream in plain Python, ns per sample, on a random walk of which a"
            " deadband sends a tenth and on the paper's scene; and the whole walk as an array with the `fast` extra,"
            " Msamples/s, in turns with its C twin."
        ),
        table(
            ("codec", "walk [ns]", "paper's scene [ns]", "`fast` extra", "C loop", "of C"),
            (
                (
                    row["codec"],
                    f"{row['walk_ns']:.0f}",
                    f"{row['paper_ns']:.0f}",
                    f"{row['fast']:.1f}" if row["fast"] else "–",
                    f"{row['c']:.1f}" if row["c"] else "–",
                    f"{row['fast'] / row['c']:.0%}" if row["fast"] and row["c"] else "–",
                )
                for row in codecs
            ),
        ),
        (
            f"{listed(slower)} {'has' if len(slower) == 1 else 'have'} no compiled kernel: whole recordings go through the"
            f" streaming pair. {results['sweep']['laws']} thresholds over one recording in one pass:"
            f" {results['sweep']['m_sample_parameters_per_s']:,.0f} million samples times thresholds a second."
        )
        if slower
        else (
            f"{results['sweep']['laws']} thresholds over one recording in one pass:"
            f" {results['sweep']['m_sample_parameters_per_s']:,.0f} million samples times thresholds a second."
        ),
    ]


def scene_cost(results: Row) -> list[str]:
    """Return nanoseconds per step of every case."""
    return [
        "Nanoseconds per step.",
        table(
            ("case", "", "median", "best"),
            (
                (title, name, f"{times['median']:.0f}", f"{times['best']:.0f}")
                for title, cases in results.items()
                for name, times in cases.items()
            ),
        ),
    ]


def virtual_time(results: Row) -> list[str]:
    """Return how fast both nodes run in virtual time."""
    return [
        "Both nodes at 1 kHz in one process.",
        table(
            ("case", "µs per virtual ms", "times real time, best", "median"),
            (
                (
                    case,
                    f"{row['us_per_virtual_ms_best']:.1f}",
                    f"{row['times_real_time_best']:.1f}",
                    f"{row['times_real_time_median']:.1f}",
                )
                for case, row in results["cases"].items()
            ),
        ),
        f"The load average was {results['load_average']:.1f} when this was measured.",
    ]


def loop(results: Row) -> list[str]:
    """Return punctuality and round trip beside their limits."""
    return [
        (
            f"Two processes on one machine, {results['scheduling']}; each beside its limit in the same run. Microseconds,"
            " medians over the repetitions."
        ),
        table(
            ("measure", "", "p50", "p99", "p99.9"),
            (
                (measure, name, *(f"{value:.1f}" for value in values))
                for measure in ("tick lateness", "position to force")
                for name, values in results[measure].items()
            ),
        ),
        "Ratios: " + listed([f"{name} {ratio:.2f}" for name, ratio in results["ratio"].items()]) + ".",
    ]
