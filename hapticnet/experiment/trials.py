"""The recordings on which codecs are compared: given ones, and the force of a scene along the motion of a hand."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.checks import axes_of, check_above
from hapticnet.errors import FileError, SampleError, SettingsError
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.samples import LARGEST_COMPONENT, PositionSample
from hapticnet.scene.base import Touchable
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import AnySceneSettings
from hapticnet.scene.sources import paper_scene

LONGEST_US: Final = 600_000_000  # longest motion [µs] that is recorded, for a hand that moves without end
DEFAULT_MOTION: Final = InsertionSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A recording on which codecs are compared; SampleError if a value is not finite or is out of range."""

    name: str  # name in tables and figures
    t_us: IntArray  # time stamps [µs], shape (n,)
    stimuli: FloatArray  # forces [N], positive out of the tissue, shape (n, a)
    positions: FloatArray | None = None  # positions of the tool [m], shape (n, a), if known
    scene: AnySceneSettings | None = None  # what was touched, at rest, if a copy of it can be made

    def __post_init__(self) -> None:
        for what, values in (("stimulus", self.stimuli), ("position", self.positions)):
            if values is None:
                continue
            good = (np.abs(values) <= LARGEST_COMPONENT).all(axis=1)
            if not good.all():
                first = int(np.argmin(good))
                raise SampleError(
                    f"{self.name}, sample {first}: {what} {values[first].tolist()} is not finite and within"
                    f" ±{LARGEST_COMPONENT:g}"
                )

    @property
    def seconds(self) -> float:
        """Duration [s], including the last sample period."""
        samples = len(self.t_us)
        span_s = float(self.t_us[-1] - self.t_us[0]) * 1e-6
        return span_s * samples / (samples - 1) if samples > 1 else 1.0

    def account(self) -> dict[str, Any]:
        """Describe the recording itself, for JSON."""
        gaps_us = np.diff(self.t_us)
        return {
            "name": self.name,
            "samples": len(self.t_us),
            "axes": self.stimuli.shape[1],
            "seconds": self.seconds,
            "period_ms": float(np.median(gaps_us)) / 1e3 if len(gaps_us) else 0.0,
            "longest_gap_ms": float(gaps_us.max(initial=0)) / 1e3,
            "peak_n": float(np.linalg.norm(self.stimuli, axis=1).max(initial=0.0)),
            "mean_speed_m_per_s": None
            if self.positions is None
            else float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum()) / self.seconds,
        }


def scene_trial(scene: Touchable, hand: Operator, *, name: str, rate_hz: float = 1000.0) -> Trial:
    """Return a trial on a perfect channel; SettingsError if hand and scene do not match, SampleError like the scene."""
    duration_us = LONGEST_US if hand.duration_us is None else min(hand.duration_us, LONGEST_US)
    check_above("rate", rate_hz, 1e6 / max(duration_us, 1), 1e6, "Hz")
    # The session starts at 0, and the first position is sent a period later.
    t_us = np.arange(round(1e6 / rate_hz), duration_us, round(1e6 / rate_hz), dtype=np.int64)
    positions = np.array([hand.sample(at_us).position_m for at_us in t_us.tolist()])
    if positions.shape[1] != scene.axes:
        raise SettingsError(f"{name}: the positions have {axes_of(positions.shape[1])}; {scene.name} has {scene.axes}")
    sent = positions.astype(np.float32).astype(np.float64)  # as on the wire
    forces = [
        scene.step(PositionSample(at_us, tuple(at_m))).force_n
        for at_us, at_m in zip(t_us.tolist(), sent.tolist(), strict=True)
    ]
    return Trial(
        name=name,
        t_us=t_us,
        stimuli=np.array(forces).reshape(sent.shape),
        positions=sent,
        scene=scene.settings if isinstance(scene, Scene | BodyScene) else None,
    )


def paper_trial(
    seed: int, rate_hz: float = 1000.0, *, insertions: int | None = None, motion: InsertionSettings = DEFAULT_MOTION
) -> Trial:
    """Return a trial of scripted insertions into the paper's scene; `seed` determines order of tissues and hand."""
    if insertions is not None:
        motion = replace(motion, insertions=insertions)
    scene = Scene(paper_scene(seed).tissues)
    return scene_trial(
        scene, ScriptedOperator(motion, np.random.default_rng(seed)), name=f"paper's scene {seed}", rate_hz=rate_hz
    )


def placed(positions: FloatArray, start: str | None) -> FloatArray:
    """Return positions [m], shape (n, a), shifted so that the first is at `start` (X[,Y[,Z]]); None: unchanged."""
    if start is None:
        return positions
    try:
        start_m = [float(part) for part in start.split(",")]
    except ValueError:
        raise SettingsError(f"start {start!r} must be one to three numbers in metres, such as 0.01,0,0") from None
    if len(start_m) != positions.shape[1]:
        raise SettingsError(
            f"the start has {len(start_m)} coordinates; the positions have {axes_of(positions.shape[1])}"
        )
    moved: FloatArray = positions - positions[0] + np.asarray(start_m, dtype=np.float64)
    return moved


def check_lasts(path: Path, t_us: IntArray) -> None:
    """Raise FileError if the samples of a file span no time."""
    if t_us[-1] == t_us[0]:
        raise FileError(f"{path}: {len(t_us)} samples over no time; at least two different times are needed")
