"""The force of the paper's scene for scripted insertions, without a network: a recording to test codecs on."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_above
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

DEFAULT_MOTION: Final = InsertionSettings()


@dataclass(frozen=True, slots=True)
class PaperRecording:
    """Positions and forces of one series of insertions.

    Attributes
    ----------
    t_us
        Time since the start of the motion [µs], shape (n,).
    force_n
        True contact force [N], positive out of the tissue, shape (n, 1).
    position_m
        Position of the needle at the slave [m], increasing into the tissue, shape (n, 1).
    breaches
        Number of tissues breached so far, shape (n,).
    """

    t_us: npt.NDArray[np.int64]
    force_n: FloatArray
    position_m: FloatArray
    breaches: npt.NDArray[np.int64]


def paper_recording(
    seed: int, rate_hz: float = 1000.0, *, insertions: int | None = None, motion: InsertionSettings = DEFAULT_MOTION
) -> PaperRecording:
    """Return the positions and forces for a seed, as the slave of a perfect channel records them.

    Parameters
    ----------
    seed
        Seed of the order of the tissues and of the operator's motion.
    rate_hz
        Sampling rate [Hz].
    insertions
        Number of insertions; None: as in `motion`.
    motion
        Motion of the insertions.

    Raises
    ------
    SettingsError
        If the seed is negative, the rate does not give one sample per script to one per µs, or a setting is invalid.
    """
    if insertions is not None:
        motion = replace(motion, insertions=insertions)
    scene = Scene(paper_scene(seed).tissues)
    operator = ScriptedOperator(motion, np.random.default_rng(seed))
    check_above("rate", rate_hz, 1e6 / operator.duration_us, 1e6, "Hz")
    period_us = round(1e6 / rate_hz)
    # The session starts at 0, and the first position is sent a period later, as float32 on the wire.
    times_us = range(period_us, operator.duration_us, period_us)
    positions_m = np.array([operator.sample(t_us).position_m[0] for t_us in times_us], dtype=np.float32)
    forces_n: list[float] = []
    breaches: list[int] = []
    for t_us, position_m in zip(times_us, positions_m.tolist(), strict=True):
        forces_n.append(scene.step(PositionSample(t_us, (position_m,))).force_n[0])
        breaches.append(scene.breaches)
    return PaperRecording(
        t_us=np.array(times_us, dtype=np.int64),
        force_n=np.array(forces_n)[:, np.newaxis],
        position_m=positions_m.astype(np.float64)[:, np.newaxis],
        breaches=np.array(breaches, dtype=np.int64),
    )
