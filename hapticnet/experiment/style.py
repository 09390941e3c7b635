"""One look for all figures: colours that colour-blind readers tell apart, markers and dashes for grey print."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from hapticnet.codec.registry import CODECS
from hapticnet.errors import SettingsError, UnavailableError

FORMATS: Final = ("png", "pdf", "svg")
PRINT_WIDTH_IN: Final = 6.3
"""Width of the text on an A4 page with usual margins [in]."""

INK: Final = "#222222"
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
"""The palette of Okabe and Ito (2008) without its yellow, which is too light for lines, and its black: INK instead."""

COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE)
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "*")
DASHES: Final[tuple[Any, ...]] = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))

SAME: Final = 0.004
"""Relative distance below which points fall on the same spot of a figure."""

SETTINGS: Final[dict[Any, Any]] = {
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.4,
    "grid.alpha": 0.5,
    "legend.frameon": False,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,  # TrueType: some publishers refuse matplotlib's usual Type 3 fonts
    "svg.hashsalt": "hapticnet",  # the same figure gives the same file
}

Points = Sequence[tuple[float, ...]]
"""Points (x, y), or (x, y, half width of x, half width of y)."""


def pyplot() -> Any:
    """Return matplotlib's pyplot, drawing to files only; an UnavailableError says what to install."""
    try:
        import matplotlib as mpl
    except ImportError as error:
        raise UnavailableError("figures need matplotlib: pip install 'hapticnet[plot]'") from error
    mpl.use("Agg")
    from matplotlib import pyplot

    return pyplot


def check_format(name: str) -> None:
    """Raise SettingsError unless figures can have the format `name`."""
    if name not in FORMATS:
        raise SettingsError(f"figure format is {name!r}; it must be {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")


@contextmanager
def picture(file: Path, height_in: float, *, width_in: float = PRINT_WIDTH_IN, **settings: Any) -> Iterator[Any]:
    """Yield an empty figure in the common look, and write it to `file`.

    Parameters
    ----------
    settings
        More settings of matplotlib, with "_" for ".".
    """
    plt = pyplot()
    extra = {key.replace("_", ".", 1): value for key, value in settings.items()}
    with plt.rc_context({**SETTINGS, **extra}):
        figure = plt.figure(figsize=(width_in, height_in), layout="constrained")
        try:
            yield figure
            # No date in the file: the same figure gives the same file.
            metadata = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(file.suffix[1:])
            figure.savefig(file, metadata=metadata)
        finally:
            plt.close(figure)


def draw_codecs(axes: Any, lines: Mapping[str, Points], *, highlight: str | None = None) -> None:
    """Draw a line for each codec; lines that coincide are drawn as one with all their names.

    A codec has the same colour, marker and dash in every figure, unless the figure has several lines of one codec.
    """
    apart: dict[str, Points] = {}
    names: dict[str, list[str]] = {}
    for label, line in lines.items():
        twin = next((other for other, drawn in apart.items() if _coincide(line, drawn)), label)
        apart.setdefault(twin, line)
        names.setdefault(twin, []).append(label)
    for label, line in apart.items():
        look, strong = _look(label, list(lines)), label == highlight
        across, up, *bars = zip(*line, strict=True)
        bars = bars if any(map(any, bars)) else []
        axes.errorbar(
            across,
            up,
            xerr=bars[0] if bars else None,
            yerr=bars[1] if bars else None,
            **look,
            elinewidth=0.6,
            capsize=1.5,
            markersize=6 if strong else 4.5,
            markeredgewidth=0.9,
            linewidth=2.2 if strong else 1.1,
            zorder=3 if strong else 2,
            label="\n= ".join(names[label]),
        )


def finish_axes(axes: Any, *, across: str = "linear") -> None:
    """Give axes their scales, the upward one logarithmic, and plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for scale, axis, set_scale, which in (
        ("log", axes.yaxis, axes.set_yscale, 1),
        (across, axes.xaxis, axes.set_xscale, 0),
    ):
        # A logarithmic axis has no place for figures that are all zero, as is the error on a constant force.
        if scale == "log" and any(value > 0.0 for line in axes.get_lines() for value in line.get_data()[which]):
            set_scale("log")
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())


def _coincide(line: Points, other: Points) -> bool:
    return len(line) == len(other) and all(
        math.isclose(a, b, rel_tol=SAME, abs_tol=1e-12)
        for point, twin in zip(line, other, strict=True)
        for a, b in zip(point[:2], twin[:2], strict=True)
    )


def _look(label: str, labels: Sequence[str]) -> dict[str, Any]:
    """Return colour, marker and dash of one of several lines."""
    names = [each.partition(":")[0].partition(",")[0].removesuffix(" (at rest)") for each in labels]
    known = [name for name in CODECS if name != "raw"]
    index, name = labels.index(label), names[labels.index(label)]
    if len(set(names)) == len(names) and set(names) <= set(known):
        index = known.index(name)
    colour = COLOURS[index % len(COLOURS)]
    return {
        "color": colour,
        "marker": MARKERS[index % len(MARKERS)],
        "linestyle": DASHES[index % len(DASHES)],
        "markerfacecolor": "white" if index % 2 else colour,
    }
