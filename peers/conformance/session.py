"""A session in virtual time: hapticnet's master, a network, and a slave, of hapticnet or of a peer."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgpack
import numpy as np

from conformance import golden
from conformance.child import Child, read_float, read_hex, write_floats, write_hex
from conformance.scenes import Hand, Spring
from conformance.script import Line, Recorder, master_line, random_line, seal_fields
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import UserOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.wire import OPEN, SEALED, Kind
from hapticnet.samples import PositionSample

NETWORKS: Final = {
    "perfect": "delay=0ms",
    "slow": "delay=40ms",
    "lossy": "delay=10ms,jitter=normal:4ms,loss=15%",
    "bursts": "delay=20ms,loss=gilbert:1%,12%,jitter=normal:5ms",
    "disorder": "delay=30ms,jitter=normal:12ms,reorder=5%,duplicate=5%",
    "near the end": "delay=480ms,jitter=normal:30ms,loss=5%",
    "too slow": "delay=700ms,jitter=normal:300ms",
}
WRAP_US: Final = 2**32 - 1_500_000  # time stamps wrap after a second and a half
MASTER, OTHER, SLAVE = (PrivateKey(bytes(range(first, first + 32))) for first in (1, 33, 65))
PSK: Final = bytes(range(97, 129))
KEY: Final = MasterKey(MASTER, SLAVE.public)
SHARED: Final = MasterKey(PrivateKey(MASTER.private, PSK), SLAVE.public)
ENTRY, OTHER_ENTRY = (MasterEntry(name=each.public.hex()[:8], public=each.public) for each in (MASTER, OTHER))
SHARING: Final = MasterEntry(name="sharing", public=MASTER.public, psk=PSK)


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What a session is made of, and what happens in it."""

    play: "Callable[[Session], None]"
    network: str = "perfect"
    codec: str = "deadband"
    parameters: Mapping[str, float] = field(default_factory=dict)
    axes: int = 1
    rate_hz: float = 1000.0
    slave: Mapping[str, Any] = field(default_factory=dict)
    key: MasterKey | None = None
    masters: tuple[MasterEntry, ...] = (ENTRY,)
    least_n: float = 0.0  # the largest force must come to this, so that something was felt
    scene: Callable[[int], Any] = Spring  # of this number of axes
    asked: Mapping[str, Any] = field(default_factory=dict)  # more of `MasterSettings`
    also: tuple[str, ...] = ()  # optional commands and keys that the peer must have


class Watched:
    """A channel that notes what is sent, and may be closed for some time."""

    def __init__(self, network: str, seed: int) -> None:
        self.emulator = Emulator[bytes](parse_channel(network), np.random.default_rng(seed))
        self.log: list[tuple[int, bytes]] = []
        self.shut: tuple[tuple[int, int], ...] = ()
        self.due, self.next_timer_us = self.emulator.due, self.emulator.next_timer_us

    def push(self, item: bytes, size: int, now_us: int) -> None:
        self.log.append((now_us, item))
        if not any(first <= now_us < last for first, last in self.shut):
            self.emulator.push(item, size, now_us)


class PeerSlave:
    """A slave of a peer with a scene, with the calls of a `SlaveNode` that a `Loopback` needs."""

    def __init__(self, child: Child, scene: Spring, seed: int | Sequence[int], seal: str | None = None) -> None:
        self.child, self.scene = child, scene
        self._outbox: list[tuple[bytes, Any]] = []
        child.tell(random_line(seed).command)
        child.ask("slave", f"scene={write_hex(scene.name)}", f"axes={scene.axes}")
        if seal is not None:
            child.ask("seal", seal)

    def receive_datagram(self, data: bytes, address: Any, now_us: int) -> None:
        place = write_hex(repr(address)[:28])
        answer, position = self.child.batch([f"receive {now_us} {write_hex(data)} {place}", "position"])
        self.child.check(answer)
        self._send(answer[3:], address)
        if position != "ok -":
            self.child.check(position)
            sample = PositionSample(0, tuple(map(read_float, position[3:].split(" "))))
            (answer,) = self.child.ask("answer", now_us, write_floats(self.scene.step(sample).force_n))
            self._send(answer, address)

    def _send(self, digits: str, address: Any) -> None:
        if digits != "-":
            self._outbox.append((read_hex(digits), address))

    def datagrams_to_send(self) -> list[tuple[bytes, Any]]:
        outbox, self._outbox = self._outbox, []
        return outbox

    def next_timer_us(self) -> None:
        """Return None: a slave sends only when it receives."""

    def close(self, reason: str, code: int, address: Any) -> None:
        (answer,) = self.child.ask("close", code, write_hex(reason))
        self._send(answer, address)

    @property
    def counts(self) -> tuple[int, ...]:
        return tuple(map(int, self.child.ask("counts")))


def listed(own: PrivateKey, masters: Sequence[MasterEntry]) -> str:
    """Return the keys of a slave, as the command `seal` has them."""
    pairs = (f"{each.public.hex()} {'-' if each.psk == NO_PSK else each.psk.hex()}" for each in masters)
    return " ".join([own.private.hex(), *pairs])


class Drawn:
    """A source of numbers that are all the same."""

    def integers(self, _low: int, _high: int, /) -> int:
        return 0x01020304


def felt_vectors() -> Iterator[tuple[str, str, list[Line]]]:
    """Return name, codec and script of each case of codecs.json, whose payloads arrive in a session."""
    number = golden.SESSION
    for case in golden.read("codecs")["cases"]:
        hand, rate_hz = Hand(case["axes"]), 1000.0
        hand.sample = lambda _, hand=hand: hand.position_m  # type: ignore[method-assign, misc]
        law = WeberLaw(**{name: case[name] for name in golden.LAW})
        settings = MasterSettings(
            codec=case["codec"], parameters=case["parameters"], law=law, rate_hz=rate_hz, name="vectors"
        )
        node = MasterNode(UserOperator(hand), None, settings, Drawn())
        first = [Line("random 01020304"), master_line(node, case["axes"], {"rate_hz": rate_hz, "name": "vectors"})]
        recorder = Recorder(node, hand, first)
        begin_us = case["samples"][0][0] - 2000
        recorder.tick(begin_us)
        recorder.datagrams_to_send()
        recorder.receive_datagram(bytes.fromhex(golden.datagrams()["welcome"]), begin_us + 100)
        for sequence, (t_us, _, position_m, payload, arrives, _) in enumerate(case["samples"], 1):
            hand.position_m = tuple(position_m)
            recorder.tick(t_us)
            recorder.datagrams_to_send()
            if arrives:
                body = msgpack.packb([t_us % 2**32, bytes.fromhex(payload)])
                recorder.receive_datagram(msgpack.packb([OPEN, Kind.FORCE, number, sequence, body]), t_us)
            recorder.drive(t_us)
        for t_us, position_m, _ in case["later"]:
            hand.position_m = tuple(position_m)
            recorder.tick(t_us)
            recorder.datagrams_to_send()
            recorder.drive(t_us)
        recorder.note()
        yield case["name"], case["codec"], recorder.lines


class Session:
    """A scenario with hapticnet's master, and a slave of hapticnet or of a peer."""

    def __init__(self, scenario: Scenario, child: Child | None = None) -> None:
        self.scenario, self.child = scenario, child
        self.hand = Hand(scenario.axes)
        asked = {"rate_hz": scenario.rate_hz, "name": "same", **scenario.asked}
        settings = MasterSettings(
            codec=scenario.codec,
            parameters=dict(scenario.parameters),
            law=WeberLaw(weber_fraction=0.05, floor_n=0.025),
            key=scenario.key,
            **asked,
        )
        node = MasterNode(UserOperator(self.hand), None, settings, np.random.default_rng(1))
        first = [random_line(1), master_line(node, scenario.axes, asked)]
        if scenario.key is not None:
            first.append(Line(f"seal {seal_fields(scenario.key)}"))
        self.recorder = Recorder(node, self.hand, first)
        self.forward, self.feedback = (Watched(NETWORKS[scenario.network], seed) for seed in (6, 7))
        master: Any = self.recorder
        self.loop: Any = Loopback(
            master, self._slave(5), forward=self.forward, feedback=self.feedback, start_us=WRAP_US
        )

    def _slave(self, seed: int | Sequence[int], axes: int | None = None, **settings: Any) -> Any:
        key, rng, scene_axes = self.scenario.key, np.random.default_rng(seed), axes or self.scenario.axes
        masters = self.scenario.masters
        if self.child is not None:
            return PeerSlave(
                self.child, self.scenario.scene(scene_axes), seed, None if key is None else listed(SLAVE, masters)
            )
        doors: dict[int, Door] | None = (
            None if key is None else {SEALED: SealedDoor(SLAVE.private, Roster(masters), rng)}
        )
        settings = {**self.scenario.slave, **settings}
        return SlaveNode(lambda _: self.scenario.scene(scene_axes), SlaveSettings(**settings), rng, doors=doors)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        self.loop.run(round(1e6 * seconds))

    def shut(self, seconds: float, *, forward: bool = True, back: bool = True) -> None:
        """Close the network from now on for a time."""
        times = self.loop.now_us, self.loop.now_us + round(1e6 * seconds)
        self.forward.shut += (times,) if forward else ()
        self.feedback.shut += (times,) if back else ()

    def restart(self, axes: int | None = None, **settings: Any) -> None:
        """Restart the slave: it knows no session any more."""
        self.loop.slave = self._slave([9, 9], axes, **settings)

    def end(self, reason: str, **code: int) -> None:
        """Let hapticnet's slave close the session."""
        self.loop.slave._end(self.loop.slave.contexts[0], reason, self.loop.now_us, **code)

    def close(self, reason: str = "done") -> None:
        """Let the master close."""
        self.loop.close(reason)

    def jump(self, us: int) -> None:
        """Let the clock jump."""
        self.loop.now_us += us
        self.loop._next_tick_us += us

    def number(self, sequence: int) -> None:
        """Give the master's next datagram a number."""
        self.recorder.session._stream.sequence = sequence
        self.recorder.lines.append(Line(f"sequence {sequence}"))

    def answers(self) -> list[str]:
        """Return what the slave sent, without what it draws, and the forces that the master applied."""
        sent = [f"{now_us} {without_drawn(data)}" for now_us, data in self.feedback.log]
        return sent + [f"{each.command} {each.answer}" for each in self.recorder.lines if each.command[:6] == "force "]


def without_drawn(data: bytes) -> Any:
    """Return a datagram of a slave without the numbers, cookies, tickets and keys that it draws, and its own words."""
    version, kind, _, sequence, body = msgpack.unpackb(data)
    if version == OPEN and kind in (Kind.REFUSE, Kind.CLOSE):
        body = msgpack.unpackb(body)[-1]  # the code; the words are each peer's own
    if version == SEALED and kind == Kind.WELCOME:
        body = b""  # it may have words, too
    if (version == SEALED or kind in (Kind.COOKIE, Kind.WELCOME)) and type(body) is bytes:
        body = len(body)
    return version, kind, sequence, body


def played(scenario: Scenario, child: Child | None = None) -> Session:
    """Play a scenario; return the session. Raise AssertionError if too little was felt."""
    session = Session(scenario, child)
    scenario.play(session)
    session.recorder.note()
    largest_n = session.recorder.largest_n
    if largest_n < scenario.least_n:
        raise AssertionError(f"the largest force is {largest_n} N, not {scenario.least_n} N")
    return session
