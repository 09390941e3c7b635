"""Figures of a comparison, one per question: packets and bytes against error, signal."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.codec.base import Codec
from hapticnet.experiment.comparison import Row, codec_label, encode_trial
from hapticnet.experiment.signal_figure import Signal, draw_signal
from hapticnet.experiment.style import INK, check_format, draw_codecs, finish_axes, legend, picture, pyplot
from hapticnet.experiment.summary import HOLD_OPTIMUM, LINE_OPTIMUM, METHOD, Block, blocks, means
from hapticnet.experiment.trials import Trial

HEIGHT_IN: Final = 4.0
SHOWN_S: Final = 4.0  # seconds of a recording in the figure of the signal: those with the most sent samples
ERROR: Final = "rmse_n"
THRESHOLD: Final = "threshold [JND]"
MOST_TICKS: Final = 8
OPTIMA: Final = {HOLD_OPTIMUM: (0, (4, 2)), LINE_OPTIMUM: (0, (1, 1.5))}
OPTIMUM_MARKERS: Final = {HOLD_OPTIMUM: "+", LINE_OPTIMUM: "x"}  # visible at a single threshold


class Figures:
    """The figures of a comparison that is still to be run; raise SettingsError, or UnavailableError without matplotlib.

    The codec whose signal is drawn over time is the first that is not raw.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        codecs: Sequence[Codec],
        *,
        folder: Path,
        form: str = "png",
        seed: int = 0,
    ) -> None:
        check_format(form)
        pyplot()
        self._trials, self._seed = trials, seed
        self._codec = next((codec for codec in codecs if codec.name != "raw"), codecs[0])
        names = ["packets-against-error", "bytes-against-error"]
        if all(codec.name == "raw" for codec in codecs):
            names = []  # raw has no error to use as an axis
        names += [f"signal-{number}-{_stem(trial.name)}" for number, trial in enumerate(trials, start=1)]
        self.files = [folder / f"{name}.{form}" for name in names]

    def draw(self, rows: Sequence[Row]) -> list[Path]:
        """Draw the figures of the rows of the comparison, all of the same trials, and return their files."""
        single = blocks(rows)
        shown = means(single) or single
        if len(self.files) > len(self._trials):
            _draw_rates(shown, self.files[0], "packets_per_s", "packets/s", 1.0)
            _draw_rates(shown, self.files[1], "wire_bytes_per_s", "kB/s, headers included", 1e-3)
        for trial, file in zip(self._trials, self.files[-len(self._trials) :], strict=True):
            signal = codec_signal(self._codec, trial, loss=rows[0].loss, seed=self._seed)
            title = f"{trial.name}: {codec_label(self._codec)}, threshold {self._codec.law.multiplier:g} JND"
            draw_signal(signal, file, window_s=_busiest(signal), title=title)
        return self.files


def codec_signal(codec: Codec, trial: Trial, *, loss: float = 0.0, seed: int = 0) -> Signal:
    """Return a codec's result on a trial over time."""
    encoding, received = encode_trial(codec, trial, loss=loss, seed=seed)
    return Signal(
        t_s=(trial.t_us - trial.t_us[0]) * 1e-6,
        true_n=trial.stimuli,
        applied_n=encoding.decoded,
        sent=encoding.sent,
        lost=np.setdiff1d(encoding.sent, received),
        law=codec.law,
    )


def _draw_rates(shown: Sequence[Block], file: Path, key: str, label: str, factor: float) -> None:
    with picture(file, HEIGHT_IN) as figure:
        axes = figure.subplots()
        draw_codecs(axes, _lines(shown, key, factor))
        for name, dash in OPTIMA.items():
            # An optimum's error is only bounded by its threshold, so it is drawn at the deadband's.
            line = [
                (plain.values[ERROR], factor * optimum.values[key])
                for block in shown
                for plain in [line for line in block.lines if line.label == "deadband"][:1]
                for optimum in block.lines
                if optimum.label == name and key in optimum.values
            ]
            if line:
                told = f"{name}\n(at the deadband's error)"
                look = {"linestyle": dash, "marker": OPTIMUM_MARKERS[name], "color": INK, "linewidth": 1.0}
                axes.plot(*zip(*sorted(line), strict=True), **look, label=told)
        finish_axes(axes, across="log")
        axes.set_xlabel("RMSE of the applied force [N]")
        axes.set_ylabel(label)
        _finish(figure, axes, shown, _without_raw(shown, key, factor, label))


def _lines(shown: Sequence[Block], key: str, factor: float) -> dict[str, list[tuple[float, ...]]]:
    """Return points (error, figure, half width of either) of each codec, one for each threshold."""
    lines: dict[str, list[tuple[float, ...]]] = {}
    for block in sorted(shown, key=lambda block: block.settings.multiplier):
        for line in block.lines:
            if line.codec not in (None, "raw"):
                half_widths = line.half_widths.get(ERROR, 0.0), factor * line.half_widths.get(key, 0.0)
                point = line.values[ERROR], factor * line.values[key], *half_widths
                lines.setdefault(line.label, []).append(point)
    return lines


def _without_raw(shown: Sequence[Block], key: str, factor: float, unit: str) -> str:
    """Return a line with the figures of raw, which is not drawn; "" if it was not compared."""
    values = [factor * line.values[key] for block in shown for line in block.lines if line.codec == "raw"]
    if not values:
        return ""
    ends = dict.fromkeys(f"{end:,.4g}" for end in (min(values), max(values)))
    return f"\nnot drawn: raw, {' to '.join(ends)} {unit}"


def _finish(figure: Any, axes: Any, shown: Sequence[Block], left_out: str) -> None:
    legend(figure, axes, below=False, handlelength=3.6, labelspacing=0.7)
    values = sorted({block.settings.multiplier for block in shown})
    ends = f"{values[0]:g} to {values[-1]:g}"
    some = ", ".join(f"{value:g}" for value in values) if len(values) <= MOST_TICKS else ends
    recordings = shown[0].trial or METHOD.format(count=shown[0].recordings)
    figure.suptitle(f"{recordings}; {THRESHOLD}: {some}{left_out}", fontsize=8)


def _busiest(signal: Signal) -> tuple[float, float]:
    """Return the stretch of SHOWN_S, or all of a shorter recording, in which the most samples are sent."""
    end_s = float(signal.t_s[-1])
    sent_s = signal.t_s[signal.sent]
    if not len(sent_s):
        return 0.0, min(SHOWN_S, end_s)
    counts = np.searchsorted(sent_s, sent_s + SHOWN_S) - np.arange(len(sent_s))
    first_s = float(sent_s[np.argmax(counts)]) - SHOWN_S / 20
    start_s = max(min(first_s, end_s - SHOWN_S), 0.0)
    return start_s, min(start_s + SHOWN_S, end_s)


def _stem(name: str) -> str:
    return "".join(character if character.isalnum() else "-" for character in name)
