"""The demo's chain in virtual time with a simulated device: the requested force, and the force felt."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from force_scenarios import started
from numpy.typing import NDArray

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import ForceLimiter
from hapticnet.device.base import Device, Reading
from hapticnet.device.simulated import Finger, PlantSettings
from hapticnet.experiment.trials import paper_trial
from hapticnet.hardware import MAX_FORCE_N, SLEW_N_PER_S
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

Numbers = NDArray[np.float64]

TICK_US: Final = 1000
INSERTIONS: Final = 2
FELT_N: Final = 0.1
"""Force [N] from which the finger counts as touched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """How the chain is set up.

    Attributes
    ----------
    codec, channel
        The feedback codec, and the emulated network in both directions.
    announced
        Whether the slave announces the contact ahead.
    first_touch
        Whether the finger is found before the session.
    predictor
        Whether the platform moves toward the force expected ahead; else toward the present one.
    foresight_s, early_n
        How far ahead [s], and the change of force [N] that triggers a response within a control period.
    on_all_fingers
        Whether to measure the chain on all fingers.
    """

    codec: str = "deadband"
    channel: str = "perfect"
    announced: bool = False
    first_touch: bool = True
    predictor: bool = True
    foresight_s: float = ForceControlSettings().foresight_s
    early_n: float = ForceControlSettings().early_n
    on_all_fingers: bool = False


CHAINS: Final = {
    "as it was": Chain(first_touch=False, predictor=False, early_n=MAX_FORCE_N),
    "answered at once": Chain(first_touch=False, predictor=False),
    "and finger found first": Chain(predictor=False),
    "deadband": Chain(on_all_fingers=True),
    "adaptive-predictive": Chain(codec="adaptive-predictive"),
    "motion-predictive": Chain(codec="motion-predictive"),
    "announced": Chain(announced=True, on_all_fingers=True),
    "announced, 25 ms late": Chain(announced=True, channel="delay=25ms"),
    "announced, 20 ms ahead": Chain(announced=True, foresight_s=0.02),
    "announced, 40 ms ahead": Chain(announced=True, foresight_s=0.04),
}


@dataclass(frozen=True, slots=True)
class Felt:
    """Target, true and sensed force [N] of each tick, and the tick of the first touch."""

    target_n: Numbers
    true_n: Numbers
    sensed_n: Numbers
    touched: int


class Watched(Device):
    """A simulated device that notes the true force of each tick."""

    def __init__(self, inner: Device) -> None:
        self._inner = inner
        self.capabilities = self._inner.capabilities
        self.delay_us = inner.delay_us
        self.description, self.status = self._inner.description, self._inner.status
        self.true_n: dict[int, float] = {}

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        reading = self._inner.exchange(displacement_m, now_us)
        self.true_n[now_us] = self._inner.contact_force_n or 0.0
        return reading


class Blindfolded(Fingertip):
    """A fingertip without force prediction."""

    __slots__ = ()

    def press(self, force_n: float, now_us: int, ahead_n: float | None = None) -> None:  # noqa: ARG002
        super().press(force_n, now_us)


def demo_target(seed: int) -> Numbers:
    """Return the force [N] that the demo requests in each ms: the scene's force after the limits."""
    largest_n = ForceControlSettings().max_force_n - ForceControlSettings().headroom_n
    limiter = ForceLimiter(largest_n, SLEW_N_PER_S)
    forces_n = np.abs(paper_trial(seed, insertions=INSERTIONS).stimuli[:, 0])
    return np.array([limiter.limit(force_n, TICK_US * tick) for tick, force_n in enumerate(forces_n.tolist())])


def chain(kind: str, seed: int, phase_ms: int, finger: Finger, settings: Chain) -> Felt:
    """Play the demo's insertions once on a device of a kind, "sim" or "simavr"."""
    with started(kind, PlantSettings(finger=finger), seed) as (device, start_us):
        return _played(Watched(device), seed, start_us + TICK_US * phase_ms, settings)


def _played(device: Watched, seed: int, start_us: int, settings: Chain) -> Felt:
    scene = paper_scene(seed)
    forward, feedback, nonces, sessions = np.random.default_rng(seed).spawn(4)
    operator = ScriptedOperator(InsertionSettings(insertions=INSERTIONS), np.random.default_rng(seed))
    control = ForceControlSettings(foresight_s=settings.foresight_s, early_n=settings.early_n)
    fingertip = (Fingertip if settings.predictor else Blindfolded)(device, control)
    asked = MasterSettings(codec=settings.codec, record=True, first_touch=settings.first_touch)
    asked = replace(asked, announced=settings.announced)
    loopback = Loopback(
        MasterNode(operator, fingertip, asked, nonces),
        SlaveNode(lambda _: Scene(scene.tissues, name=scene.name), SlaveSettings(), sessions),
        forward=Emulator(parse_channel(settings.channel), forward),
        feedback=Emulator(parse_channel(settings.channel), feedback),
        start_us=start_us,
    )
    while not loopback.master.connected:
        loopback.run(TICK_US)
    loopback.run(operator.duration_us)
    assert loopback.master.recording is not None
    table = loopback.master.recording.table()
    true_n = np.array([device.true_n[t_us] for t_us in table["t_us"].astype(int).tolist()])
    felt = true_n > FELT_N
    touched = int(felt.argmax()) if not settings.first_touch else 0
    return Felt(table["target_n"], true_n, table["sensed_n"], touched)
