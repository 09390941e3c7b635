"""One run of both nodes in virtual time over a link that loses datagrams in bursts."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import ChannelSettings, GilbertElliottLoss, Jitter
from hapticnet.codec.schemes.raw import Raw
from hapticnet.measure.metrics import error_report
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.settings import RepairSettings, SessionSettings
from hapticnet.protocol.states import LinkStale
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind, unpack
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

WAYS: Final = {
    "no repair": RepairSettings(replaces=False, repeats=False, paces=False),
    "replace": RepairSettings(repeats=False, paces=False),
    "replace, repeat": RepairSettings(paces=False),
    "replace, pace": RepairSettings(repeats=False),
    "all": RepairSettings(),
}
"""Ways to repair; "replace" is what the first version of the protocol did."""

LAW: Final = WeberLaw()
PERIOD_US: Final = 1000
SHORTEST_INSERTION_S: Final = 4.5
WARM_UP_US: Final = 2_000_000
"""Time from which errors, bytes and releases count: the loss of a link is unknown before its first loss."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One link and one way to repair its losses.

    Attributes
    ----------
    signal
        Name of the paper's scene or of a recording.
    loss, burst
        Share of the datagrams that are lost, in each direction, and mean length of a burst.
    clock
        Unit of a burst's length: "datagrams" of a direction, or "ms" of time.
    delay_us, jitter_us
        One way, in each direction; deviation of a half-normal jitter that keeps the order.
    seconds
        Duration; the signal is repeated until then.
    """

    signal: str
    repair: str
    codec: str = "deadband"
    loss: float = 0.0
    burst: float = 1.0
    clock: str = "datagrams"
    delay_us: int = 0
    jitter_us: int = 0
    seed: int = 1
    seconds: float = 20.0


class Lossy:
    """A channel that notes losses, and whose bursts can be measured in time instead of datagrams."""

    def __init__(self, case: Case, rng: np.random.Generator) -> None:
        chain = gilbert(case.loss, case.burst)
        settings = ChannelSettings(
            delay_us=case.delay_us,
            jitter=Jitter(distribution="normal", deviation_us=case.jitter_us) if case.jitter_us else None,
        )
        self._channel: Emulator[bytes] = Emulator(settings, rng.spawn(1)[0])
        self.due, self.next_timer_us = self._channel.due, self._channel.next_timer_us
        self._fates = chain.fates(rng) if chain is not None else None
        self._timed = case.clock == "ms"
        self._chain_us = 0
        self._bad = False
        self.by_kind = [0] * (max(Kind) + 1)
        self.wire_bytes = 0
        self.lost_forces: deque[tuple[int, int]] = deque()  # sequence and time of sending

    def push(self, item: bytes, size_bytes: int, now_us: int) -> None:
        """Send a datagram, unless it is lost."""
        datagram = unpack(item)
        self.by_kind[datagram.kind] += 1
        self.wire_bytes += size_bytes + UDP_IPV4_HEADER_BYTES
        if self._fates is not None and self._is_lost(self._fates, now_us):
            if datagram.kind is Kind.FORCE:
                self.lost_forces.append((datagram.sequence, now_us))
            return
        self._channel.push(item, size_bytes, now_us)

    def _is_lost(self, fates: Iterator[bool], now_us: int) -> bool:
        if not self._timed:
            return next(fates)
        while self._chain_us <= now_us:
            self._bad = next(fates)
            self._chain_us += PERIOD_US
        return self._bad


def gilbert(loss: float, burst: float) -> GilbertElliottLoss | None:
    """Return the chain with a mean loss and a mean length of bursts; a length of 1 means independent losses."""
    if not loss:
        return None
    leave = 1.0 / burst if burst > 1.0 else 1.0 - loss
    return GilbertElliottLoss(p=loss * leave / (1.0 - loss), r=leave)


class RecordedScene:
    """A scene whose force is a recording that is played forwards and backwards in turns, whatever the position."""

    name = "recording"
    axes = 1
    breaches = 0

    def __init__(self, force_n: list[float]) -> None:
        self._force_n = force_n + force_n[::-1]

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force of that time."""
        return ForceSample(sample.t_us, (self._force_n[sample.t_us // PERIOD_US % len(self._force_n)],))


class Still:
    """An operator that hardly moves."""

    axes = 1
    duration_us = None

    def sample(self, elapsed_us: int) -> PositionSample:
        """Return a position."""
        return PositionSample(elapsed_us, (1e-3,))


@dataclass(frozen=True, slots=True)
class Signal:
    """The felt signal: a recording [N], or the paper's scene."""

    name: str
    force_n: list[float] | None = None

    def operator(self, case: Case) -> Operator:
        """Return the operator of a case."""
        if self.force_n is not None:
            return Still()
        insertions = math.ceil(case.seconds / SHORTEST_INSERTION_S)
        return ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng(case.seed))

    def scene(self, case: Case) -> Any:
        """Return a new scene of a case."""
        if self.force_n is not None:
            return RecordedScene(self.force_n)
        return Scene(paper_scene(case.seed).tissues)


class Watched:
    """Both nodes; each tick notes the applied force, and the one that would be applied without delay."""

    def __init__(self, signal: Signal, case: Case) -> None:
        forward, feedback, nonces, sessions = np.random.default_rng(case.seed).spawn(4)
        session = SessionSettings(repair=WAYS[case.repair])
        operator = signal.operator(case)
        self.master = MasterNode(operator, None, MasterSettings(codec=case.codec, law=LAW, session=session), nonces)
        slave = SlaveNode(lambda _: signal.scene(case), SlaveSettings(session=session), sessions)
        self.forward, self.feedback = Lossy(case, forward), Lossy(case, feedback)
        self.link = Loopback(self.master, slave, forward=self.forward, feedback=self.feedback)
        self.true_n: list[float] = []
        self.applied_n: list[float] = []
        self.releases = 0
        self.stale = 0
        self.recoveries_us: list[int] = []
        self._operator = operator
        self._truth = signal.scene(case)
        self._payloads, self._positions = Raw().encoder(1), Raw().decoder(1)
        self._released = False
        self._drive = self.master.drive
        self.master.drive = self._drive_and_note  # type: ignore[method-assign]

    def run(self, seconds: float) -> None:
        """Connect, warm up, and play the signal."""
        while not self.true_n:
            self.link.run(PERIOD_US)
        self._play(WARM_UP_US)
        self.releases = self.stale = 0
        self.recoveries_us.clear()
        for channel in (self.forward, self.feedback):
            channel.wire_bytes = 0
            channel.by_kind = [0] * len(channel.by_kind)
        self._play(round(1e6 * seconds))

    def _play(self, duration_us: int) -> None:
        end_us = self.link.now_us + duration_us
        lost = self.feedback.lost_forces
        while self.link.now_us < end_us:
            self.link.run(PERIOD_US)
            while (event := self.master.next_event()) is not None:
                self.stale += isinstance(event, LinkStale)
            stream = self.master.session._stream
            newest = None if stream is None else stream.newest_force
            while lost and newest is not None and newest >= lost[0][0]:
                self.recoveries_us.append(self.link.now_us - lost.popleft()[1])

    def _drive_and_note(self, now_us: int) -> None:
        self._drive(now_us)
        start_us = self.master._script_start_us
        if start_us is None:
            return
        # The position of this tick, as the slave would read it.
        payload = self._payloads.encode(now_us, self._operator.sample(now_us - start_us).position_m)
        self._positions.decode(now_us, payload or b"")
        sample = PositionSample(now_us, self._positions.reconstruct(now_us))
        self.true_n.append(self._truth.step(sample).force_n[0])
        self.applied_n.append(self.master.held_force_n(now_us)[0])
        hold = self.master._applied._hold
        released = hold._age_us > hold._age_limit_us
        self.releases += released and not self._released
        self._released = released


def run(signal: Signal, case: Case) -> dict[str, Any]:
    """Run a case and return what it cost and what it did to the applied force."""
    watched = Watched(signal, case)
    watched.run(case.seconds)
    true_n, applied_n = (np.array(each)[:, np.newaxis] for each in (watched.true_n, watched.applied_n))
    skipped = WARM_UP_US // PERIOD_US
    # Each tick applies before it sends, so the applied force answers the previous tick's position at best.
    lag = 1 + 2 * case.delay_us // PERIOD_US
    present = error_report(LAW, true_n[skipped:], applied_n[skipped:])
    late = error_report(LAW, true_n[skipped - lag : -lag], applied_n[skipped:])
    recoveries_ms = np.array(watched.recoveries_us) / 1e3
    by_kind = watched.feedback.by_kind
    return asdict(case) | {
        "exceed": present.exceed_jnd_fraction,
        "exceed_by_loss": late.exceed_jnd_fraction,
        "rmse_n": present.rmse_n,
        "rmse_by_loss_n": late.rmse_n,
        "forward_bytes_per_s": watched.forward.wire_bytes / case.seconds,
        "feedback_bytes_per_s": watched.feedback.wire_bytes / case.seconds,
        "forces_per_s": by_kind[Kind.FORCE] / case.seconds,
        "keepalives_per_s": by_kind[Kind.KEEPALIVE] / case.seconds,
        "releases": watched.releases,
        "stale": watched.stale,
        "lost_updates": len(recoveries_ms),
        "recovery_median_ms": float(np.median(recoveries_ms)) if len(recoveries_ms) else None,
        "recovery_p99_ms": float(np.percentile(recoveries_ms, 99)) if len(recoveries_ms) else None,
    }
