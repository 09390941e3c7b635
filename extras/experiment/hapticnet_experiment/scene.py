"""The tissues of a trial, named by the master, so that one slave serves a whole session, here or on another host.

::

    hapticnet slave --scene hapticnet_experiment.scene:NamedTissues

The name of a master is, for instance, ``trial 17 of 3.5,2,5 N, 20 mm``: breach forces front to back, and the distance
between surfaces.
"""

import re
from collections.abc import Sequence
from typing import Final

from hapticnet.errors import SettingsError
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue

SCENE_SPEC: Final = "hapticnet_experiment.scene:NamedTissues"
_NAME: Final = re.compile(r"trial \d+ of ([0-9.]{1,8}),([0-9.]{1,8}),([0-9.]{1,8}) N, ([0-9.]{1,8}) mm")


def tissues(breach_forces_n: Sequence[float], gap_m: float) -> tuple[Tissue, ...]:
    """Return tissues that are each breached at half the distance to the next, as in the paper's scene.

    Breach forces [N] are front to back; `gap_m` [m] is the distance between surfaces, and in front of the first.
    """
    return tuple(
        Tissue(
            name=f"tissue {number}",
            rest_position_m=number * gap_m,
            stiffness_n_per_m=force_n / (gap_m / 2.0),
            breach_force_n=force_n,
        )
        for number, force_n in enumerate(breach_forces_n, start=1)
    )


def master_name(number: int, breach_forces_n: Sequence[float], gap_m: float) -> str:
    """Return the name by which a master asks for the tissues of trial `number`."""
    forces = ",".join(f"{force_n:g}" for force_n in breach_forces_n)
    return f"trial {number} of {forces} N, {1000.0 * gap_m:g} mm"


class NamedTissues:
    """Three tissues whose breach forces are in the master's name. See the module."""

    axes = 1
    name = "study"  # the name that masters see; it must not reveal the order

    def __init__(self) -> None:
        self._scene: Scene | None = None

    @property
    def breaches(self) -> int:
        """Surfaces breached so far."""
        return 0 if self._scene is None else self._scene.breaches

    def welcome(self, master: str) -> None:
        """Make the tissues that a master names; raise SettingsError if it names none."""
        match = _NAME.fullmatch(master)
        if match is None:
            raise SettingsError(f"this slave serves 'hapticnet experiment'; {master[:40]!r} names no tissues")
        *forces_n, gap_mm = (float(number) for number in match.groups())
        self._scene = Scene(tissues(forces_n, gap_mm / 1000.0), name=self.name)

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force at a position; 0 before `welcome`."""
        return ForceSample(sample.t_us, (0.0,)) if self._scene is None else self._scene.step(sample)
