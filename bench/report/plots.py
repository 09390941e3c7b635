"""Draw the figures of the benchmark pages from the results."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import NullLocator

from hapticnet.experiment.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    draw_codecs,
    finish_axes,
    legend,
    picture,
)

Row = dict[str, Any]

CODECS: Final = (
    "deadband", "adaptive-predictive", "linear-predictive", "least-squares", "level-crossing", "velocity-adaptive"
)  # fmt: skip
CONDITIONS: Final = {"none": (GREY, "."), "1 JND": (BLUE, "o"), "2 JND": (ORANGE, "s"), "4 JND": (GREEN, "^")}
REPAIRS: Final = {"no repair": (GREY, "."), "replace": (ORANGE, "s"), "all": (BLUE, "o")}
FELT: Final = {"raw": (GREY, "."), "deadband": (BLUE, "o"), "linear-predictive": (GREEN, "^"),
               "adaptive-predictive": (ORANGE, "s"), "passive-extrapolative": (PURPLE, "v"),
               "motion-predictive": (VERMILION, "D")}  # fmt: skip
REDUCTIONS: Final = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998)


def draw(records: dict[str, Row], folder: Path) -> None:
    """Write every figure, as a PNG named after its function, to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, function, (width_in, height_in) in FIGURES:
        file = folder / f"{function.__name__}.png"
        with picture(
            file, height_in, width_in=width_in, font_size=10.0, axes_titlesize=11.0, savefig_dpi=110
        ) as figure:
            function(figure, records[name]["results"])


def packets_against_error(figure: Figure, results: Row) -> None:
    """Draw packets over error on the paper's scene, with raw and the optimum."""
    axes = figure.subplots()
    _codecs(axes, results, "paper's scene")
    raw = next(row for row in results["averages"] if (row["signals"], row["codec"]) == ("paper's scene", "raw"))
    finish_axes(axes, across="log")
    axes.axhline(raw["packets_per_s"], color=GREY, linestyle="-.", label="raw: every sample")
    axes.set_ylabel("packets/s")
    legend(figure, axes, below=False)


def other_signals(figure: Figure, results: Row) -> None:
    """Draw packets over error on one recording, if there is one, and made signals."""
    recorded = [row["name"] for row in results["signals"] if row["kind"] == "recorded"]
    shown = [*recorded[-1:], "smooth palpation", "noisy hold", "stiff wall"]
    columns = figure.subplots(1, len(shown), sharey=True)
    for axes, signal in zip(columns, shown, strict=True):
        _codecs(axes, results, signal)
        axes.set_title(signal, fontsize=11)
    finish_axes(*columns, across="log")
    columns[0].set_ylabel("packets/s")
    legend(figure, columns[0])


def _codecs(axes: Axes, results: Row, signal: str) -> None:
    own = [row for row in results["averages"] if row["signals"] == signal and not row["loss"] and not row["step_n"]]
    own.sort(key=lambda row: row["multiplier"])
    rows = {codec: [row for row in own if row["codec"] == codec] for codec in CODECS}
    points = {codec: [(row["rmse_n"], row["packets_per_s"]) for row in rows[codec]] for codec in CODECS}
    draw_codecs(axes, points, highlight="adaptive-predictive")
    _line(axes, rows["deadband"], "rmse_n", "optimum_holds_per_s", INK, "_", "--", label="fewest possible, held")
    _line(axes, rows["deadband"], "rmse_n", "optimum_lines_per_s", INK, "_", ":", label="fewest possible, lines")
    axes.set_xlabel("RMSE of the applied force [N]")


def packet_rate(figure: Figure, results: Row) -> None:
    """Draw the saving over the sampling rate, with the paper's, and over the error."""
    (left, right), (rates, errors) = _side_by_side(figure, 2)
    scripted_s, paper = results["motion"]["push_s"], 100 * results["paper_byte_reduction"]
    scene = [row | {"saved": 100 * row["byte_reduction"], "left": 1 - row["packet_rate_reduction"]}
             for row in results["scene"]]  # fmt: skip
    for curve, dashes in zip(results["over_speeds"], ("-", "--", "-.", ":", (0, (1, 3))), strict=False):
        rows = [row | {"saved": 100 * row["byte_reduction"]} for row in curve["rows"]]
        if curve["push_s"] != scripted_s:
            _line(rates, rows, "rate_hz", "saved", BLUE, "", dashes, label=f"1 JND, push of {curve['push_s']:g} s")
        elif curve["crossing_hz"]:
            rates.plot(curve["crossing_hz"], paper, "o", color=VERMILION, markersize=10, fillstyle="none", zorder=4)
    for condition, (colour, marker) in CONDITIONS.items():
        rows = [row for row in scene if row["condition"] == condition]
        errors.scatter([row["rmse_n"] for row in rows], [row["left"] for row in rows], color=colour, marker=marker,
                       label=condition, zorder=3)  # fmt: skip
        if condition != "none":
            _line(rates, rows, "rate_hz", "saved", colour, marker, label=f"{condition}, push of {scripted_s:g} s")
    rates.axhline(paper, color=VERMILION, linewidth=1.0, label=f"the paper's {paper:.1f} % at 1 JND")
    _rate_axis(rates, sorted({row["rate_hz"] for row in scene}), "sampling rate [Hz]")
    rates.set_ylim(18, 101)
    rates.set_ylabel("fewer bytes per penetration than raw [%], headers included")
    legend(left, rates, ncols=3)
    for rate_hz in dict.fromkeys(row["rate_hz"] for row in scene):
        rows = [row for row in scene if row["rate_hz"] == rate_hz]
        _line(errors, rows, "rmse_n", "left", GREY, "")
        errors.annotate(f"{rate_hz:g} Hz", (rows[-1]["rmse_n"], rows[-1]["left"]), xytext=(9, -3),
                        textcoords="offset points")  # fmt: skip
    errors.set_yscale("log")
    errors.set_yticks([1 - reduction for reduction in REDUCTIONS], [f"{100 * each:g}" for each in REDUCTIONS])
    errors.yaxis.set_minor_locator(NullLocator())
    errors.invert_yaxis()
    errors.margins(x=0.2)
    errors.set_xlabel("RMSE of the applied force [N]")
    errors.set_ylabel("fewer packets than raw, whole run [%]")
    legend(right, errors)


def force_loop(figure: Figure, results: Row) -> None:
    """Draw the step on each finger, and settling and ripple over the control rate."""
    (left, right), (steps, rates) = _side_by_side(figure, 2)
    from_n, to_n = results["from_n"], results["to_n"]
    for index, (row, colour) in enumerate(zip(results["step"], (BLUE, ORANGE, GREEN, VERMILION, PURPLE), strict=False)):
        raised_n, t_ms = 0.5 * index, [1e3 * t_s for t_s in row["trace"]["t_s"]]
        target = [t_ms[0], 0.0, 0.0, t_ms[-1]], [from_n + raised_n] * 2 + [to_n + raised_n] * 2
        steps.plot(*target, color=GREY, linewidth=0.8, label=None if index else "target")
        for force, dashes in (("sensed", "-"), ("true", ":")):
            values = [force_n + raised_n for force_n in row["trace"][f"{force}_n"]]
            steps.plot(t_ms, values, dashes, color=colour, linewidth=1.3, label=None if index else force)
        text = f"{row['stiffness_n_m'] / 1000:g} N/mm" + (f", +{raised_n:g} N" if index else "")
        steps.annotate(text, (t_ms[-1], to_n + raised_n), xytext=(0, -14), textcoords="offset points", ha="right")
    steps.set_xlabel("time since the step [ms]")
    steps.set_ylabel("force [N], each finger raised by 0.5 N")
    legend(left, steps)
    ripples = rates.twinx()
    for axes, force, name, colour, marker, label in (
        (rates, "true", "settling_s", BLUE, "o", "5 % settling of the true force [ms]"),
        (ripples, "sensed", "ripple_peak_to_peak_n", VERMILION, "D", "ripple of the averaged reading [mN]"),
    ):
        for which, dashes in (("median", "-"), ("worst", ":")):
            rows = []
            for row in results["rates"]:
                (usual,) = [finger for finger in row["fingers"] if finger["stiffness_n_m"] == 1000.0]
                value = usual[force][name][which]
                rows.append({"rate_hz": row["rate_hz"], "value": float("nan") if value is None else 1e3 * value})
            _line(axes, rows, "rate_hz", "value", colour, marker, dashes, label=f"{label}, {which}")
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(label, color=colour)
    _rate_axis(rates, [row["rate_hz"] for row in results["rates"]], "control rate [Hz], 1 N/mm")
    ripples.spines["right"].set_visible(True)
    legend(right, rates, ripples, ncols=1)


def felt(figure: Figure, results: Row) -> None:
    """Draw what a hand feels above 1 JND, and the energy created, over the delay."""
    kinds = [kind for kind in dict.fromkeys(row["kind"] for row in results["means"]) if kind != "recorded"]
    grid = figure.subplots(2, len(kinds), sharex=True, sharey="row")
    codecs = [codec for codec in dict.fromkeys(row["codec"] for row in results["means"]) if codec in FELT]
    for (above, below), kind in zip(grid.T, kinds, strict=True):
        for codec in codecs:
            colour, marker = FELT[codec]
            key = (kind, codec, "delay alone")
            own = [row for row in results["means"] if (row["kind"], row["codec"], row["link"]) == key]
            # The passive codecs are above 1 JND most of the time, which would hide the others.
            shown = (below,) if codec == "passive-extrapolative" else (above, below)
            for axes in shown:
                figure_name = "exceed_jnd_fraction" if axes is above else "created_share"
                rows = [row | {"percent": 100 * row[figure_name]} for row in own if row[figure_name] is not None]
                _line(axes, rows, "delay_ms", "percent", colour, marker, "--" if codec == "raw" else "-", label=codec)
        above.set_title(kind, fontsize=11)
        below.set_xlabel("delay of each way [ms]")
        below.set_yscale("symlog", linthresh=10.0)
        below.set_yticks([0, 2, 5, 10, 20, 50, 100, 200], ["0", "2", "5", "10", "20", "50", "100", "200"])
        for axes in (above, below):
            axes.set_xscale("symlog", linthresh=5.0)
            axes.set_xticks(results["delays_ms"], [f"{each}" for each in results["delays_ms"]])
            axes.xaxis.set_minor_locator(NullLocator())
    for row in grid:
        row[0].set_ylim(bottom=0.0)
    grid[0][0].set_ylabel("ticks at which the force felt is off by\nmore than 1 JND [%]")
    grid[1][0].set_ylabel("energy created / work of the hand [%]")
    legend(figure, grid[1][0], ncols=len(codecs))


def repair(figure: Figure, results: Row) -> None:
    """Draw exceedance that loss causes over extra bytes, a point for each loss, on three links."""
    links = (("datagrams", 100_000), ("ms", 100_000), ("datagrams", 20_000))
    columns = figure.subplots(1, len(links), sharey=True)
    own = [row for row in results["rows"] if row["signal"] == "paper's scene" and row["codec"] == "deadband"]
    for axes, (clock, delay_us) in zip(columns, links, strict=True):
        for way, (colour, marker) in REPAIRS.items():
            key = (way, clock, delay_us, 5.0, 0)
            rows = [
                {"bytes": 100 * row["more_bytes"], "exceed": 100 * row["exceed_by_loss"]} | {"loss": row["loss"]}
                for row in own
                if (row["repair"], row["clock"], row["delay_us"], row["burst"], row["jitter_us"]) == key and row["loss"]
            ]
            rows.sort(key=lambda row: row["loss"])
            _line(axes, rows, "bytes", "exceed", colour, marker, label=way)
            for row in rows:
                axes.annotate(f"{row['loss']:.0%}", (row["bytes"], row["exceed"]), fontsize=7, color=colour,
                              textcoords="offset points", xytext=(4, 4))  # fmt: skip
        axes.set_title(f"bursts of 5 {clock}, {delay_us // 1000} ms each way", fontsize=10)
        axes.set_xlabel("more bytes, both directions [%]")
    columns[0].set_ylabel("samples that loss puts above 1 JND [%]")
    columns[0].set_ylim(bottom=0.0)
    legend(figure, columns[0])


def stability(figure: Figure, results: Row) -> None:
    """Draw where an arm comes to rest over the worst link, for three codecs and couplings."""
    shown = ("deadband", "direct"), ("deadband", "energy-bounded"), ("motion-predictive", "energy-bounded")
    looks = {
        "rests, feels the true stiffness": SKY,
        "rests, feels another stiffness": GREY,
        "moves by less than 5 mm": ORANGE,
        "swings": VERMILION,
    }
    columns = figure.subplots(1, len(shown), sharey=True)
    for axes, (codec, coupling) in zip(columns, shown, strict=True):
        (row,) = (
            each
            for each in results["rows"]
            if (each["codec"], each["coupling"], each["hand"], each["link"])
            == (codec, coupling, results["hands"][0], results["links"][-1])
        )
        for cell in row["cells"]:
            at = (
                results["delays_ms"].index(round(cell["delay_ms"])),
                results["stiffnesses"].index(cell["stiffness_n_per_m"]),
            )
            rests = 0 if cell["transparent"] else 1
            look = list(looks)[rests if cell["stable"] else 2 if cell["swing_m"] < 0.005 else 3]
            axes.bar(at[0], 0.94, 0.94, at[1] - 0.47, color=looks[look], alpha=0.8, label=look)
        axes.set_title(f"{codec}, {coupling}")
        axes.grid(visible=False)
        axes.set_xticks(range(len(results["delays_ms"])), [f"{each:g}" for each in results["delays_ms"]])
        axes.set_yticks(range(len(results["stiffnesses"])), [f"{each:g}" for each in results["stiffnesses"]])
        axes.set_xlabel("round trip [ms]")
    columns[0].set_ylabel("stiffness of the wall [N/m]")
    legend(figure, *columns)


def _side_by_side(figure: Figure, count: int) -> tuple[list[FigureBase], list[Axes]]:
    """Return parts of a figure, each with its own axes and room for a legend."""
    parts = list(figure.subfigures(1, count))
    return parts, [part.subplots() for part in parts]


def _line(
    axes: Axes,
    rows: Sequence[Row],
    x: str,
    y: str,
    colour: str,
    marker: str,
    dashes: Any = "-",
    label: str | None = None,
) -> None:
    axes.plot([row[x] for row in rows], [row[y] for row in rows], color=colour, marker=marker, linestyle=dashes,
              markersize=5, linewidth=1.3, label=label)  # fmt: skip


def _rate_axis(axes: Axes, rates_hz: Sequence[float], label: str) -> None:
    axes.set_xscale("log")
    axes.set_xticks(rates_hz, [f"{rate_hz:g}" for rate_hz in rates_hz])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel(label)


FIGURES: Final[tuple[tuple[str, Callable[[Figure, Row], None], tuple[float, float]], ...]] = (
    ("rate_distortion", packets_against_error, (8.6, 5.0)),
    ("rate_distortion", other_signals, (16.0, 4.6)),
    ("packet_rate", packet_rate, (12.5, 5.8)),
    ("force_loop", force_loop, (12.5, 5.8)),
    ("repair", repair, (12.6, 4.8)),
    ("felt", felt, (12.9, 7.4)),
    ("stability", stability, (14.0, 4.6)),
)
"""Benchmark, the function that draws from its results, and width and height [in]."""
