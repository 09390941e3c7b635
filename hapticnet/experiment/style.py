"""One look for all figures: colours that colour-blind readers tell apart, markers and dashes for grey print."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from hapticnet.codec.registry import every_codec
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.files import replacing_bytes

FORMATS: Final = ("png", "pdf", "svg")
PRINT_WIDTH_IN: Final = 6.3  # width of the text on an A4 page with usual margins [in]
INK: Final = "#222222"
GREY: Final = "#9aa5b1"
# The palette of Okabe and Ito (2008) without its yellow, which is too light for lines, and its black: INK instead.
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE)
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "*")
DASHES: Final[tuple[Any, ...]] = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
LOG_MARK: Final = ", log scale"
LOG_SPAN: Final = 5.0  # largest over smallest figure from which on an upward axis is logarithmic
SAME: Final = 0.004  # relative distance below which points fall on the same spot of a figure

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

Points = Sequence[tuple[float, ...]]  # points (x, y), or (x, y, half width of x, half width of y)


def pyplot() -> Any:
    """Return matplotlib's pyplot, drawing to files only; an UnavailableError says what to install."""
    os.environ["MPLBACKEND"] = "Agg"  # matplotlib refuses to be imported with an unknown backend
    try:
        import matplotlib as mpl
    except ImportError as error:
        raise UnavailableError("figures need matplotlib (extra plot): pip install matplotlib") from error
    mpl.use("Agg")
    from matplotlib import pyplot

    return pyplot


def check_format(name: str) -> None:
    """Raise SettingsError unless figures can have the format `name`."""
    if name not in FORMATS:
        raise SettingsError(f"figure format is {name!r}; it must be {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")


@contextmanager
def picture(file: Path, height_in: float, *, width_in: float = PRINT_WIDTH_IN, **settings: Any) -> Iterator[Any]:
    """Yield an empty figure in the common look for `file`; `settings` are matplotlib's, with "_" for "."."""
    plt = pyplot()
    from matplotlib.text import Text

    extra = {key.replace("_", ".", 1): value for key, value in settings.items()}
    with plt.rc_context({**SETTINGS, **extra}):
        figure = plt.figure(figsize=(width_in, height_in), layout="constrained")
        try:
            yield figure
            _declare_logs(figure)
            for text in figure.findobj(Text):
                if "$" in text.get_text() and "\\mathdefault" not in text.get_text():  # used by the numbers of axes
                    text.set_parse_math(False)  # a name from a file, which must not be read as a formula
            # No date in the file: the same figure gives the same file.
            metadata = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(file.suffix[1:])
            with replacing_bytes(file, follow=False) as stream:
                figure.savefig(stream, format=file.suffix[1:], metadata=metadata)
        finally:
            plt.close(figure)


def legend(owner: Any, *axes: Any, below: bool = True, ncols: int = 4, **options: Any) -> None:
    """Put one legend of all lines outside of the axes, where it hides nothing: below a figure, or at its right."""
    handles: dict[str, Any] = {}
    for each in axes:
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    # Lines with error bars first, in their order: matplotlib lists plain lines before them.
    ordered = sorted(handles.items(), key=lambda item: not hasattr(item[1], "has_yerr"))
    if handles:
        columns = min(ncols, len(handles)) if below else 1
        place = "outside lower center" if below else "outside right center"
        owner.legend(
            [handle for _, handle in ordered], [label for label, _ in ordered], loc=place, ncols=columns, **options
        )


def legend_above(axes: Any) -> None:
    """Put the legend of one of several axes above them, at the right."""
    columns = len(axes.get_legend_handles_labels()[1])
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=columns)


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


def finish_axes(*panels: Any, across: str = "linear") -> None:
    """Give related axes the same scales, and plain numbers.

    The upward scale is logarithmic where the figures span a factor of `LOG_SPAN`, else it begins at 0.
    """
    values = [
        [value for axes in panels for line in axes.get_lines() for value in line.get_data()[which] if value > 0.0]
        for which in (0, 1)
    ]
    spans = bool(values[1]) and max(values[1]) >= LOG_SPAN * min(values[1])
    for axes in panels:
        if spans:
            _make_log(axes.yaxis, axes.set_yscale)
        else:
            axes.set_ylim(bottom=0.0)
        # A logarithmic axis cannot show figures that are all zero, like the error on a constant force.
        if across == "log" and values[0]:
            _make_log(axes.xaxis, axes.set_xscale)


def _make_log(axis: Any, set_scale: Any) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    set_scale("log")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _declare_logs(figure: Any) -> None:
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            text = axis.get_label_text()
            if axis.get_scale() in ("log", "symlog") and text and LOG_MARK not in text:
                axis.set_label_text(text + LOG_MARK)


def _coincide(line: Points, other: Points) -> bool:
    return len(line) == len(other) and all(
        math.isclose(a, b, rel_tol=SAME, abs_tol=1e-12)
        for point, twin in zip(line, other, strict=True)
        for a, b in zip(point[:2], twin[:2], strict=True)
    )


def _look(label: str, labels: Sequence[str]) -> dict[str, Any]:
    names = [each.partition(":")[0].partition(",")[0].removesuffix(" (at rest)") for each in labels]
    known = [name for name in every_codec() if name != "raw"]
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
