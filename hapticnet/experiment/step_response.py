"""Step response of the force loop: the standard figures of control engineering, and the paper's Fig. 2."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hapticnet.errors import SettingsError
from hapticnet.experiment.style import BLUE, INK, ORANGE, legend, picture

Numbers: TypeAlias = NDArray[np.float64]
RISE_FROM: Final = 0.1
RISE_TO: Final = 0.9  # fractions of the step between which the rise time is measured: the 10–90 % convention
SETTLED_WITHIN: Final = 0.05  # fraction of the step within which the response counts as settled: the 5 % convention
LEAD_IN_S: Final = 0.25  # how much is drawn before the step [s]
STEADY_FRACTION: Final = 0.25  # last share of the step that counts as steady; there is no convention


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFigures:
    """Figures of a step response. The reference is the target, so that a steady error makes them worse."""

    rise_s: float | None  # time [s] from crossing 10 % of the step to crossing 90 %; None if it is not reached
    overshoot: float  # largest excess over the target, as a fraction of the step; 0 if there is none
    settling_s: float | None  # time [s] until it stays within 5 % of the step around the target; None if never
    steady_error_n: float  # mean force less target [N] over the last quarter of the recording after the step
    ripple_peak_to_peak_n: float
    ripple_rms_n: float  # range (largest less smallest) and standard deviation of the force [N] in that quarter


def step_figures(
    t_s: Sequence[float] | Numbers, force_n: Sequence[float] | Numbers, *, at_s: float, from_n: float, to_n: float
) -> StepFigures:
    """Return the figures of a step at `at_s` [s] in a recorded force [N], shape (n,), at increasing times [s].

    Crossings are interpolated. SettingsError if the step has no height, or fewer than two samples follow it.
    """
    times, forces = np.asarray(t_s, dtype=np.float64), np.asarray(force_n, dtype=np.float64)
    if from_n == to_n:
        raise SettingsError(f"the step goes from {from_n:g} to {to_n:g} N; the forces must differ")
    after = times >= at_s
    if after.sum() < 2:
        raise SettingsError(f"{after.sum()} samples follow the step at {at_s:g} s; at least 2 are needed")
    # Include the sample before the step, because the first interval may contain a crossing.
    first = max(int(after.argmax()) - 1, 0)
    since_s = times[first:] - at_s
    done = (forces[first:] - from_n) / (to_n - from_n)
    started_s, risen_s = _reached_s(since_s, done, RISE_FROM), _reached_s(since_s, done, RISE_TO)
    steady = forces[times >= times[-1] - STEADY_FRACTION * (times[-1] - at_s)]
    return StepFigures(
        rise_s=None if started_s is None or risen_s is None else risen_s - started_s,
        overshoot=max(0.0, float(done[since_s >= 0.0].max()) - 1.0),
        settling_s=_settled_s(since_s, done),
        steady_error_n=float(steady.mean()) - to_n,
        ripple_peak_to_peak_n=float(np.ptp(steady)),
        ripple_rms_n=float(steady.std()),
    )


def averaged(force_n: Numbers, samples: int) -> Numbers:
    """Return the mean of each sample and the `samples` - 1 before it, as in the force loop's input; shape (n,)."""
    padded = np.concatenate([np.full(samples - 1, force_n[0]), force_n])
    return np.convolve(padded, np.full(samples, 1.0 / samples), "valid")


def plot_step(
    file: Path,
    t_s: Sequence[float] | Numbers,
    target_n: Sequence[float] | Numbers,
    force_n: Sequence[float] | Numbers,
    *,
    contact_force_n: Sequence[float] | Numbers | None = None,
    title: str = "",
) -> None:
    """Draw the paper's Fig. 2: target, sensed and, if known, true force [N] over the time since the step [s]."""
    with picture(file, 3.8) as figure:
        axes = figure.subplots()
        axes.step(t_s, target_n, where="post", color=BLUE, linewidth=1.4, label="target")
        axes.plot(t_s, force_n, color=ORANGE, linewidth=1.6, label="sensed")
        if contact_force_n is not None:
            axes.plot(t_s, contact_force_n, color=INK, linewidth=1.0, linestyle="--", label="true force on the finger")
        axes.set_xlabel("time since the step [s]")
        axes.set_ylabel("force [N]")
        axes.set_ylim(bottom=0.0)
        axes.set_xlim(left=max(-LEAD_IN_S, float(t_s[0])))
        legend(figure, axes)
        axes.set_title(title)


def _reached_s(since_s: Numbers, done: Numbers, level: float) -> float | None:
    """Return the time when the response first reaches a fraction of the step, not before the step."""
    reached = np.flatnonzero((done >= level) & (since_s >= 0.0))
    return _crossing_s(since_s, done, int(reached[0]), level) if reached.size else None


def _settled_s(since_s: Numbers, done: Numbers) -> float | None:
    outside = np.flatnonzero(np.abs(done - 1.0) > SETTLED_WITHIN)
    if not outside.size or since_s[outside[-1]] < 0.0:
        return 0.0
    last = int(outside[-1])
    if last == len(done) - 1:
        return None
    return _crossing_s(since_s, done, last + 1, 1.0 + math.copysign(SETTLED_WITHIN, done[last] - 1.0))


def _crossing_s(since_s: Numbers, done: Numbers, index: int, level: float) -> float:
    """Return the time when the line from the sample before `index` to the sample at `index` crosses a level."""
    if index == 0:
        return float(max(since_s[0], 0.0))
    before, after = float(done[index - 1]), float(done[index])
    share = (level - before) / (after - before) if after != before else 1.0
    crossed_s = since_s[index - 1] + min(max(share, 0.0), 1.0) * (since_s[index] - since_s[index - 1])
    return float(max(crossed_s, 0.0))
