"""The recordings that ``hapticnet compare`` tries codecs on: files, scenes under a scripted hand, or both."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticnet.errors import SettingsError

if TYPE_CHECKING:
    from hapticnet.experiment.trials import Trial
    from hapticnet.recordings.loading import Motion, Recording


def recorded_trials(files: Sequence[Path], say: Callable[[str], None], **reading: Any) -> "list[Trial]":
    """Return the forces and positions of files; `reading` says how to read them, as for `load_recording`."""
    from hapticnet.experiment.trials import Trial
    from hapticnet.recordings.loading import load_recording

    return [
        Trial(name=name, t_us=found.t_us, stimuli=found.force, positions=found.position)
        for name, found in _read(files, partial(load_recording, **reading), say)
    ]


def scene_trials(
    scene: str, files: Sequence[Path], say: Callable[[str], None], *, start: str | None, seed: int, **reading: Any
) -> "list[Trial]":
    """Return the forces of a scene along the positions of files, or of a scripted hand if there are none.

    The first position of each file is put at `start`, as text of coordinates [m]; None: where it is. `reading` says how
    to read the files, as for `load_motion`.
    """
    import numpy as np

    from hapticnet.experiment.trials import placed, scene_trial
    from hapticnet.operator.scripted import scripted_hand
    from hapticnet.operator.trace import TraceOperator
    from hapticnet.recordings.loading import load_motion
    from hapticnet.scene.sources import find_source

    source = find_source(scene)
    if not files:
        touched = source.make()
        hand = scripted_hand(touched.axes, 2, np.random.default_rng(seed))
        return [scene_trial(touched, hand, name=f"{source.name}, scripted hand {seed}")]
    at_m = None if start is None else parse_start(start)
    trials = []
    for name, motion in _read(files, partial(load_motion, **reading), say):
        trace = TraceOperator(motion.t_us, placed(motion.position, at_m))
        trials.append(scene_trial(source.make(), trace, name=f"{source.name}, {name}"))
    return trials


def parse_start(text: str) -> tuple[float, ...]:
    """Return coordinates written as X[,Y[,Z]] [m]; raise SettingsError if they are not numbers."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(f"start {text!r} must be one to three numbers in metres, such as 0.01,0,0") from None


def _read(
    files: Sequence[Path], read: "Callable[[Path], Motion | Recording]", say: Callable[[str], None]
) -> "list[tuple[str, Any]]":
    """Return name and content of each file; files whose names are alike get their whole paths."""
    from hapticnet.errors import FileError

    stems = [file.stem for file in files]
    found = []
    for file in files:
        content = read(file)
        for note in content.notes:
            say(f"{file}: {note}")
        if content.t_us[-1] == content.t_us[0]:
            raise FileError(
                f"{file}: {len(content.t_us)} samples over no time; at least two different times are needed"
            )
        found.append((file.stem if stems.count(file.stem) == 1 else str(file), content))
    return found
