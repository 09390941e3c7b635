"""The chain of a session in real time: one device throughout, and a session with the slave for each trial."""

import asyncio
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, Self

from hapticnet.errors import HapticnetError, UnavailableError
from hapticnet.node.events import NodeEvent
from hapticnet.node.fingertip import DeviceLost, Fingertip, ForceFault
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import Operator
from hapticnet.runtime.recorder import unix_offset_us
from hapticnet.runtime.runners import MasterRunner
from hapticnet.runtime.serial_port import SerialPort, Wire, open_wire
from hapticnet.runtime.system import SystemEntropy, now_us
from hapticnet.runtime.timer import Ticker, either, until
from hapticnet.runtime.udp import HostPort, open_toward
from hapticnet.runtime.watching import Watcher, Watchers
from hapticnet_experiment.rig import (
    TICK_US,
    Activity,
    Fault,
    LiftWatch,
    Meet,
    Outcome,
    Presentation,
    disturbance,
    emulators,
    outcome_of,
    procedure_of,
)
from hapticnet_experiment.scene import SCENE_SPEC, NamedTissues
from hapticnet_experiment.trial import Stimulus

if TYPE_CHECKING:
    from hapticnet.node.procedures import Meeting

CONNECT_WITHIN_S: Final = 10.0


class RealRig:
    """The chain in real time. Use it as an asynchronous context manager.

    `fingertip`, `wire` and `hand` stay for the whole session; `hand` is a person's. `watchers` run beside it. The slave
    at `address` serves `scene.NamedTissues`; hand and address are None without trials. `tell` is called with lines for
    the experimenter.
    """

    def __init__(
        self,
        fingertip: Fingertip,
        settings: MasterSettings,
        address: HostPort | None,
        *,
        tell: Callable[[str], None],
        wire: Wire | None = None,
        hand: Operator | None = None,
        watchers: Sequence[Watcher[NodeEvent]] = (),
    ) -> None:
        self.deepest_m: float | None = None
        self.fingertip = fingertip
        self._settings = settings
        self._address = address
        self._wire = wire
        self._hand = hand
        self._watchers = Watchers[NodeEvent](watchers, tell)
        self._serial: SerialPort | None = None
        self._ticker: Ticker | None = None
        self._procedure: Meeting | Presentation | None = None
        self._performed: asyncio.Future[Outcome] | None = None
        self._stop = asyncio.Event()
        self._stopped = False
        self._playing = False
        self._closing: asyncio.Task[Any] | None = None
        self._lost: str | None = None

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        if self._wire is not None:
            self._serial = await open_wire(self._wire, asyncio.Event())
        try:
            await self._watchers.start()
        except BaseException:
            if self._serial is not None:
                await self._serial.stop()
            raise
        self._ticker = Ticker(loop, TICK_US, self._tick)
        return self

    async def __aexit__(self, *_: object) -> None:
        self.stop()
        if self._closing is not None:
            await self._closing
        self._press_nothing(now_us())
        if self._ticker is not None:
            self._ticker.stop()
        await self._watchers.stop()
        if self._serial is not None:
            await self._serial.stop()

    def now_us(self) -> int:
        """Return the time [µs] on the monotonic clock."""
        return now_us()

    async def wait(self, duration_us: int) -> None:
        """Let time [µs] pass without a force."""
        await asyncio.sleep(duration_us / 1e6)

    def stop(self) -> None:
        """End the present activity: the force goes to zero at once."""
        self._stopped = True
        self._stop.set()
        if self._performed is not None and not self._performed.done():
            self._performed.set_result(Fault("stopped", lost=False))
            self._procedure = None
            self._press_nothing(now_us())

    async def run(self, activity: Activity) -> Outcome:
        """Perform an activity until it is over or `stop` is called."""
        self._stopped = False
        if self._closing is not None:
            await self._closing
            self._closing = None
        if self._stopped:  # meanwhile
            return Fault("stopped", lost=False)
        if not isinstance(activity, Meet) and self._lost is not None:
            return Fault(self._lost)
        self._stop.clear()
        try:
            if isinstance(activity, Stimulus):
                return await self._play(activity)
            self._lost = None
            self._performed = asyncio.get_running_loop().create_future()
            self._procedure = procedure_of(activity, self.fingertip)
            return await self._performed
        except HapticnetError as error:
            return Fault(str(error), lost=isinstance(error, UnavailableError) and not isinstance(activity, Stimulus))
        finally:
            self._procedure = self._performed = None

    async def _play(self, stimulus: Stimulus) -> Outcome:
        if self._address is None or self._hand is None:
            raise UnavailableError("no slave or no hand was named")
        sock, slave = open_toward(self._address)
        node = MasterNode(self._hand, self.fingertip, stimulus.master_settings(self._settings), SystemEntropy())
        disturbances = _Disturbances(self, node)
        self.deepest_m = -math.inf
        forward, feedback = (None if each.settings.is_perfect else each for each in emulators(stimulus))
        runner = MasterRunner(
            node, sock, slave, stop=self._stop, channel=forward, channel_in=feedback, watchers=[disturbances]
        )
        self._playing = True
        await runner.start()
        try:
            if not await either(runner.connected, self._stop, CONNECT_WITHIN_S):
                return Fault(f"no session with the slave at {self._address}: is it running there?", lost=False)
            if not runner.connected.is_set():  # ticks are recorded before there is a session, but nothing was played
                return Fault("stopped", lost=False)
            if node.scene_name not in (None, NamedTissues.name):
                wrong = f"the slave at {self._address} serves the scene {node.scene_name!r}"
                return Fault(f"{wrong}; start it with --scene {SCENE_SPEC}", lost=False)
            await until(self._stop, stimulus.limit_s)
        finally:
            node.paused = "the trial is over"  # so that no force is held while the session closes
            self.deepest_m = None
            self._press_nothing(now_us())
            self._closing = asyncio.ensure_future(self._close(runner))
        return outcome_of(node, stimulus, disturbances.fault, runner.missed_ticks, unix_offset_us())

    async def _close(self, runner: MasterRunner) -> None:
        try:
            await runner.finish("the trial is over")
        finally:
            self._playing = False

    def _tick(self, now: int) -> None:
        """Drive the device between trials."""
        if self._playing:
            return
        procedure, performed = self._procedure, self._performed
        if procedure is None or performed is None or performed.done():
            self._press_nothing(now)
        else:
            try:
                if procedure.tick(now):
                    performed.set_result(procedure.result())
            except HapticnetError as error:
                performed.set_result(Fault(str(error)))
                self._press_nothing(now)
        self._after_tick(now)
        while (event := self.fingertip.next_event()) is not None:
            if isinstance(event, DeviceLost | ForceFault):
                self._lost = event.reason

    def _after_tick(self, now: int) -> None:
        if self._serial is not None:
            self._serial.flush(now)
        self._watchers.observe(now)

    def _press_nothing(self, now: int) -> None:
        self.fingertip.press(0.0, now)
        if self._serial is not None:
            self._serial.flush(now)


class _Disturbances(Watcher[NodeEvent]):
    """Ends a trial when its link or its device fails, and passes ticks and events to the hand and the wire."""

    name = "study"

    def __init__(self, rig: RealRig, node: MasterNode) -> None:
        self.fault: Fault | None = None
        self._rig = rig
        self._node = node
        self._lift = LiftWatch()

    def observe(self, now_us: int) -> None:
        """Pass a tick on; end the trial if the finger is lifted."""
        rig = self._rig
        rig._after_tick(now_us)
        if rig.deepest_m is not None and self._node.position_m is not None:
            rig.deepest_m = max(rig.deepest_m, self._node.position_m[0])
        self._end(self._lift.check(rig.fingertip.target_n, rig.fingertip.sensed_n, now_us))

    def note(self, event: NodeEvent, now_us: int) -> None:
        """End the trial if this event spoils it."""
        self._rig._watchers.note(event, now_us)
        self._end(disturbance(event))

    def _end(self, fault: Fault | None) -> None:
        if fault is not None and self.fault is None and not self._rig._stop.is_set():
            self.fault = fault
            if fault.lost:
                self._rig._lost = fault.reason
            self._rig._stop.set()

    def check(self, now_us: int) -> None:
        """Pass it on."""
        self._rig._watchers.check(now_us)
