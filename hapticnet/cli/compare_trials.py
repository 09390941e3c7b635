"""The recordings that ``hapticnet compare`` tries codecs on: files, scenes under a scripted hand, or both."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    trials = []
    for name, motion in _read(files, partial(load_motion, **reading), say):
        trace = TraceOperator(motion.t_us, placed(motion.position, start))
        trials.append(scene_trial(source.make(), trace, name=f"{source.name}, {name}"))
    return trials


def _read(
    files: Sequence[Path], read: "Callable[[Path], Motion | Recording]", say: Callable[[str], None]
) -> "list[tuple[str, Any]]":
    """Return name and content of each file; files whose names are alike get their whole paths."""
    from hapticnet.experiment.trials import check_lasts

    stems = [file.stem for file in files]
    found = []
    for file in files:
        content = read(file)
        for note in content.notes:
            say(f"{file}: {note}")
        check_lasts(file, content.t_us)
        found.append((file.stem if stems.count(file.stem) == 1 else str(file), content))
    return found
