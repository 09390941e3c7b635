"""The series of a measurement of the JND: each pair and its answer, for a look at how a participant answered."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from hapticnet.experiment.style import BLUE, COLOURS, GREY, MARKERS, legend, picture
from hapticnet.study.figures import FORMS, titled
from hapticnet.study.rows import LimitsRow

HEIGHT_IN: Final = 3.0


def draw_series(rows: Sequence[LimitsRow], folder: Path) -> list[Path]:
    """Draw the series of each session as PDF and PNG; return the files.

    Raises
    ------
    UnavailableError
        If matplotlib is missing.
    """
    answered = [row for row in rows if row.event == "trial" and row.reference_n and row.difference_n is not None]
    files = []
    for (participant, session), own in _grouped(answered, "participant", "session"):
        references_n = sorted({row.reference_n for row in own if row.reference_n is not None})
        for form in FORMS:
            file = folder / f"series-{participant}-{session}.{form}"
            with picture(file, HEIGHT_IN) as figure:
                panels = figure.subplots(1, len(references_n), sharey=True, squeeze=False)[0]
                for axes, reference_n in zip(panels, references_n, strict=True):
                    _reference(axes, [row for row in own if row.reference_n == reference_n], reference_n)
                panels[0].set_ylim(bottom=min(0.0, panels[0].get_ylim()[0]))  # once all are drawn: they share the axis
                panels[0].set_ylabel("difference, % of the reference")
                _explain(panels[-1], own[0].method)
                legend(figure, panels[-1])
                text = f"Series of participant {participant}, session {session} ({own[0].method})"
                figure.suptitle(titled(text, sorted({row.observer for row in own if row.observer})), fontsize=9)
            files.append(file)
    return files


def _reference(axes: Any, rows: Sequence[LimitsRow], reference_n: float) -> None:
    for place, (_, series) in enumerate(_grouped(rows, "series")):
        steps = range(1, len(series) + 1)
        shares = [100.0 * (row.difference_n or 0.0) / reference_n for row in series]
        colour = GREY if series[0].catch else COLOURS[place % len(COLOURS)]
        axes.plot(steps, shares, color=colour, linewidth=0.8, zorder=2)
        for step, share, row in zip(steps, shares, series, strict=True):
            filled = row.answer == "different" or row.correct == 1
            face = colour if filled else "white"
            axes.plot(step, share, MARKERS[place % len(MARKERS)], color=colour, markerfacecolor=face, markersize=3.6)
    axes.set_title(f"{reference_n:g} N")
    axes.set_xlabel("pair of the series")
    axes.xaxis.get_major_locator().set_params(integer=True)


def _explain(axes: Any, method: str | None) -> None:
    """Tell the legend what filled, open and grey marks mean."""
    filled, empty = ("different", "same") if method == "ascending" else ("right", "wrong")
    kinds = [(BLUE, BLUE, filled), (BLUE, "white", empty)]
    if method == "ascending":
        kinds.append((GREY, GREY, "nothing changes"))
    for edge, face, label in kinds:
        axes.plot([], [], "o", color=edge, markerfacecolor=face, markersize=3.6, label=label)


def _grouped(rows: Sequence[LimitsRow], *names: str) -> list[tuple[Any, list[LimitsRow]]]:
    def key(row: LimitsRow) -> Any:
        values = tuple(getattr(row, name) for name in names)
        return values if len(values) > 1 else values[0]

    return [(value, list(own)) for value, own in groupby(sorted(rows, key=key), key=key)]
