"""The chain through which a session plays its stimuli: device and force loop, and for each trial a network and a scene.

A session finds the finger, presents pairs of forces (for a JND), and plays trials (of the ordering task). `VirtualRig`
runs in virtual time with a simulated device, `real_rig.RealRig` in real time.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeAlias

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.errors import UnavailableError
from hapticnet.node.events import Failed, NodeEvent
from hapticnet.node.fingertip import DeviceLost, Fingertip, ForceFault
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.procedures import Meeting, Met, Procedure
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import Operator
from hapticnet.protocol.states import Ended, LinkStale, Refused, SessionLost
from hapticnet_experiment.scene import NamedTissues
from hapticnet_experiment.trial import LINK_LOST, Played, Stimulus, played, scripted_hand

TICK_US: Final = 1000
LEAD_US: Final = 300_000  # time [µs] from the start of a presentation to the first force
SLICE_US: Final = 100_000  # interval [µs] at which a trial in virtual time is checked for events
SETTLE_US: Final = 300_000  # time [µs] after the last motion of a script, until the device has delivered the last force
LIFTED: Final = "the finger was lifted"
LIFTED_N: Final = 0.1
PRESSED_N: Final = 0.5
LIFTED_US: Final = 500_000  # a finger is lifted if at most LIFTED_N is felt for this long at PRESSED_N requested
RECOVERY_US: Final = 1_000_000  # longest time [µs] in which the force loop recovers from a fault, at rest
MakeHand: TypeAlias = Callable[[Stimulus], Operator]  # makes the hand of a trial


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Present two forces to compare, in this order."""

    forces_n: tuple[float, float]
    stimulus_us: int  # duration of each
    gap_us: int  # between them


@dataclass(frozen=True, slots=True, kw_only=True)
class Presented:
    """Result of a pair on the device: held forces, and means sensed in each second half [N]."""

    held_n: tuple[float, float]
    sensed_n: tuple[float, float]

    def missed(self, tolerance: float, least_n: float = 0.05) -> str | None:
        """Return why the pair must be presented again; None if both forces were delivered.

        `tolerance` is a share of the held force; `least_n` [N], the error of loop and sensor, is always tolerated.
        """
        for held_n, sensed_n in zip(self.held_n, self.sensed_n, strict=True):
            if abs(sensed_n - held_n) > max(tolerance * held_n, least_n):
                return f"{held_n:.3f} N was felt as {sensed_n:.3f} N"
        return None


@dataclass(frozen=True, slots=True)
class Meet:
    """Let the platform find the finger."""


Activity: TypeAlias = Meet | Pair | Stimulus  # activities of a rig; a stimulus lasts until there is an answer


@dataclass(frozen=True, slots=True)
class Fault:
    """An activity failed, for `reason`; the finger must be found again if it was `lost`."""

    reason: str
    lost: bool = True


Outcome: TypeAlias = Met | Presented | Played | Fault


class Rig(Protocol):
    """A performer of a session's activities."""

    deepest_m: float | None  # deepest position [m] of the needle in the present trial; None if unknown

    def now_us(self) -> int:
        """Return the time [µs]."""

    async def run(self, activity: Activity) -> Outcome:
        """Perform an activity until it is over or `stop` is called. The finger feels no force afterwards."""

    def stop(self) -> None:
        """End the present activity: the force goes to zero at once."""

    async def wait(self, duration_us: int) -> None:
        """Let time [µs] pass without a force."""


class Presentation(Procedure):
    """Present a pair. Each force rises and falls as hold and limiter allow."""

    def __init__(self, fingertip: Fingertip, pair: Pair) -> None:
        super().__init__(fingertip)
        self._pair = pair
        self._hold = Hold(HoldSettings())
        self._sums = [[0.0, 0.0], [0.0, 0.0]]

    def tick(self, now_us: int) -> bool:
        """Do the next step; return whether both forces are finished."""
        elapsed_us = self._elapsed_us(now_us)
        if elapsed_us is None:
            self.fingertip.press(0.0, now_us)
            return False
        pair = self._pair
        at_us = elapsed_us - LEAD_US
        period_us = pair.stimulus_us + pair.gap_us
        interval, within_us = divmod(at_us, period_us) if at_us >= 0 else (0, pair.stimulus_us)
        if interval > 1 or (interval == 1 and within_us >= pair.stimulus_us):
            self.fingertip.press(0.0, now_us)
            return elapsed_us >= LEAD_US + 2 * period_us
        force_n = pair.forces_n[interval] if within_us < pair.stimulus_us else 0.0
        self._hold.receive((force_n,), now_us)  # like a packet in each tick
        self.fingertip.press(self._hold.value(now_us)[0], now_us)
        if pair.stimulus_us // 2 <= within_us < pair.stimulus_us and (reading := self.fingertip.reading) is not None:
            sums = self._sums[interval]
            sums[0] += 1.0
            sums[1] += reading.force_n
        return False

    def result(self) -> Presented:
        """Return the felt forces."""
        first_n, second_n = (total_n / count if count else 0.0 for count, total_n in self._sums)
        return Presented(held_n=self._pair.forces_n, sensed_n=(first_n, second_n))


def procedure_of(activity: Meet | Pair, fingertip: Fingertip) -> Meeting | Presentation:
    """Return the procedure that performs an activity without a slave."""
    return Meeting(fingertip) if isinstance(activity, Meet) else Presentation(fingertip, activity)


def disturbance(event: NodeEvent) -> Fault | None:
    """Return why an event ends a trial; None if it does not."""
    if isinstance(event, LinkStale | SessionLost):
        return Fault(LINK_LOST, lost=False)
    if isinstance(event, DeviceLost):
        return Fault(f"the device was lost: {event.reason}")
    if isinstance(event, ForceFault | Failed):
        return Fault(event.reason)
    if isinstance(event, Refused | Ended):
        return Fault(f"the session ended: {getattr(event, 'reason', 'refused')}", lost=False)
    return None


def outcome_of(
    node: MasterNode, stimulus: Stimulus, fault: Fault | None, missed_ticks: int = 0, unix_offset_us: int = 0
) -> Played | Fault:
    """Return a master's record of a trial, which a fault may have ended; the fault if it sent no position."""
    found = played(node, stimulus, None if fault is None else fault.reason, missed_ticks, unix_offset_us)
    return found or fault or Fault("no position was sent", lost=False)


class LiftWatch:
    """Notices that the finger is no longer against the platform."""

    def __init__(self) -> None:
        self._since_us: int | None = None

    def check(self, target_n: float, sensed_n: float, now_us: int) -> Fault | None:
        """Return whether the finger was certainly lifted; call it every tick with the forces [N]."""
        if target_n < PRESSED_N or sensed_n > LIFTED_N:
            self._since_us = None
        elif self._since_us is None:
            self._since_us = now_us
        elif now_us - self._since_us > LIFTED_US:
            return Fault(LIFTED, lost=False)
        return None


def emulators(stimulus: Stimulus) -> tuple[Emulator[Any], Emulator[Any]]:
    """Return the networks of a trial, there and back."""
    first, second = (
        Emulator[Any](parse_channel(spec), np.random.default_rng([stimulus.seed, number]))
        for number, spec in enumerate((stimulus.forward, stimulus.feedback), start=1)
    )
    return first, second


class VirtualRig:
    """The chain in virtual time. Nothing waits, and the same seeds give the same session. Each hand must end."""

    def __init__(self, fingertip: Fingertip, settings: MasterSettings, *, make_hand: MakeHand = scripted_hand) -> None:
        self.deepest_m: float | None = None  # a scripted hand reaches every tissue
        self._fingertip = fingertip
        self._settings = settings
        self._make_hand = make_hand
        self._now_us = 0

    def now_us(self) -> int:
        """Return the virtual time [µs]."""
        return self._now_us

    async def wait(self, duration_us: int) -> None:
        """Let time [µs] pass without a force."""
        end_us, fingertip = self._now_us + duration_us, self._fingertip
        recovered_us = min(end_us, self._now_us + RECOVERY_US)
        while fingertip.controller.fault is not None and self._now_us < recovered_us:
            fingertip.press(0.0, self._now_us)
            self._now_us += TICK_US
        self._now_us = end_us

    def stop(self) -> None:
        """End the present activity; in virtual time it has ended already."""

    async def run(self, activity: Activity) -> Outcome:
        """Perform an activity."""
        if isinstance(activity, Stimulus):
            return self._play(activity)
        procedure = procedure_of(activity, self._fingertip)
        try:
            while not procedure.tick(self._now_us):
                self._now_us += TICK_US
            self._now_us += TICK_US
            return procedure.result()
        except UnavailableError as error:
            return Fault(str(error))

    def _play(self, stimulus: Stimulus) -> Outcome:
        hand = self._make_hand(stimulus)
        forward, feedback = emulators(stimulus)
        scene = NamedTissues()
        settings = stimulus.master_settings(self._settings)
        loopback = Loopback(
            MasterNode(hand, self._fingertip, settings, np.random.default_rng([stimulus.seed, 5])),
            SlaveNode(lambda _: scene, SlaveSettings(), np.random.default_rng([stimulus.seed, 6])),
            forward=forward,
            feedback=feedback,
            start_us=self._now_us,
        )
        duration_us = hand.duration_us if hand.duration_us is not None else round(stimulus.limit_s * 1e6)
        end_us = self._now_us + duration_us + SETTLE_US
        fault = None
        while loopback.now_us < end_us and fault is None:
            loopback.run(min(SLICE_US, end_us - loopback.now_us))
            while (event := loopback.master.next_event()) is not None:
                fault = fault or disturbance(event)
        self._now_us = loopback.now_us
        self._fingertip.press(0.0, self._now_us)
        return outcome_of(loopback.master, stimulus, fault)


def play_trial(stimulus: Stimulus) -> Played:
    """Play one trial in virtual time, with a device that has found the finger; raise UnavailableError if it fails."""
    device = SimulatedDevice(PlantSettings(), np.random.default_rng([stimulus.seed, 9]))
    rig = VirtualRig(Fingertip(device, ForceControlSettings()), MasterSettings())
    asyncio.run(rig.run(Meet()))
    outcome = asyncio.run(rig.run(stimulus))
    if not isinstance(outcome, Played):
        reason = f" failed: {outcome.reason}" if isinstance(outcome, Fault) else " was not played"
        raise UnavailableError(f"a simulated trial with {stimulus.codec}{reason}")
    return outcome
