"""Error of the applied stimuli against the true ones, sample by sample. `measure.metrics` is for recordings."""

import math
from dataclasses import asdict

from hapticnet.measure.metrics import ErrorReport
from hapticnet.parts import PartsLaw
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import magnitude


class RunningError:
    """Running errors in constant memory."""

    __slots__ = ("_exceeded", "_floor_n", "_largest", "_squares", "_weber_fraction", "samples")

    def __init__(self, law: WeberLaw) -> None:
        self._weber_fraction, self._floor_n = law.weber_fraction, law.floor_n
        self.samples = 0
        self._squares = 0.0
        self._largest = 0.0
        self._exceeded = 0

    def add(self, true: Vector, applied: Vector) -> None:
        """Add one sample."""
        self.samples += 1
        if len(true) == 1:
            error, size = abs(true[0] - applied[0]), abs(applied[0])
        else:
            error, size = magnitude(tuple(x - y for x, y in zip(true, applied, strict=True))), magnitude(applied)
        if not error:  # the rest does not change then
            return
        self._squares += error * error
        if error > self._largest:
            self._largest = error
        if error > self._floor_n and error > self._weber_fraction * size:  # `jnd_n` inlined
            self._exceeded += 1

    def report(self) -> ErrorReport:
        """Return the errors so far; all are 0 if nothing was added."""
        samples = max(self.samples, 1)
        return ErrorReport(
            rmse_n=math.sqrt(self._squares / samples),
            max_error_n=self._largest,
            exceed_jnd_fraction=self._exceeded / samples,
        )


class PartsError:
    """Running errors of every part. Replaces a `RunningError`."""

    def __init__(self, law: PartsLaw) -> None:
        self._parts = tuple(
            (part.label, each, RunningError(own))
            for part, each, own in zip(law.parts, law.slices(), law.laws, strict=True)
        )

    def add(self, true: Vector, applied: Vector) -> None:
        """Add one sample."""
        for _, each, error in self._parts:
            error.add(true[each], applied[each])

    def report(self) -> ErrorReport:
        """Return the errors of the first part so far."""
        return self._parts[0][2].report()

    def by_part(self) -> dict[str, ErrorReport]:
        """Return the errors of every part, by its label."""
        return {label: error.report() for label, _, error in self._parts}


def parts_report(error: RunningError | PartsError) -> dict[str, dict[str, dict[str, float]]]:
    """Return the errors of every part for JSON, under "parts"; nothing if there are no parts."""
    if isinstance(error, RunningError):
        return {}
    return {"parts": {label: asdict(report) for label, report in error.by_part().items()}}


def running_error(law: WeberLaw) -> RunningError | PartsError:
    """Return what adds up errors of stimuli of a law."""
    return PartsError(law) if isinstance(law, PartsLaw) else RunningError(law)
