"""Whoever carries the datagrams of a sealed session can do no more than someone who cuts the cable."""

import math
from dataclasses import dataclass, field
from typing import Any

import pytest

from hapticnet.control.hold import HoldSettings
from hapticnet.hardware import SLEW_N_PER_S
from hapticnet.node.master import MasterNode
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.states import ForceArrived, HoldConfirmed
from tests.attacks.injector import Injector
from tests.attacks.network import SECOND, Hand, Line, Network, make_master, make_slave

TIMINGS = SessionSettings()
HOLD = HoldSettings()
RELEASED_US = HOLD.age_limit_us + HOLD.decay_us
TICK_US = 1_000


@dataclass
class Witness:
    """What the slave sent and what the master applied."""

    forces: set[tuple[int, int, int, bytes]] = field(default_factory=set)
    keepalives: set[tuple[int, int]] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)
    applied: int = 0
    confirmed: int = 0
    alive_us: int = -RELEASED_US
    force_n: float = 0.0


def watch(monkeypatch: pytest.MonkeyPatch, network: Network) -> Witness:
    """Return a witness of every force and keepalive, with what was wrong about those that the master used."""
    witness = Witness()
    true_force, true_keepalive, true_digest = SlaveSession.force, SlaveSession.keepalive, MasterNode._digest
    newest: dict[int, int] = {}

    def force(self: SlaveSession, t_us: int, payload: bytes, now_us: int, **more: Any) -> bytes:
        witness.forces.add((self.number, self._sequence, t_us, payload))
        return true_force(self, t_us, payload, now_us, **more)

    def keepalive(self: SlaveSession, t_us: int, now_us: int, **more: Any) -> bytes:
        witness.keepalives.add((self.number, t_us))
        return true_keepalive(self, t_us, now_us, **more)

    def digest(self: MasterNode, event: object, now_us: int) -> None:
        number = self.session.number
        if isinstance(event, ForceArrived):
            witness.applied += 1
            witness.alive_us = now_us
            if (number, event.sequence, event.t_us, event.payload) not in witness.forces:
                witness.wrong.append(f"{event} was not sent in session {number}")
            if event.sequence <= newest.get(number, -1):
                witness.wrong.append(f"{event} after {newest[number]}")
            newest[number] = event.sequence
        elif isinstance(event, HoldConfirmed):
            witness.confirmed += 1
            witness.alive_us = now_us
            if (number, event.t_us) not in witness.keepalives:
                witness.wrong.append(f"{event} was not sent in session {number}")
        if isinstance(event, ForceArrived | HoldConfirmed) and now_us - event.t_us > TIMINGS.max_age_us:
            witness.wrong.append(f"{event} at {now_us}")
        true_digest(self, event, now_us)  # type: ignore[arg-type]

    monkeypatch.setattr(SlaveSession, "force", force)
    monkeypatch.setattr(SlaveSession, "keepalive", keepalive)
    monkeypatch.setattr(MasterNode, "_digest", digest)
    assert network
    return witness


def insert(t_us: int) -> float:
    """A needle that goes 20 to 60 mm deep and comes out, every two seconds: 0 to 6 N."""
    return 0.02 + 0.04 * math.sin(math.pi * t_us / SECOND)


def attacked(*, sealed: bool, forges: bool, seed: int) -> tuple[Network, Line, Injector]:
    injector = Injector(seed, forges=forges)
    network = Network(make_slave(sealed=sealed, seed=seed))
    line = network.add(
        make_master(Hand(insert), sealed=sealed), ("192.0.2.1", 4000), injector.forward, injector.feedback
    )
    return network, line, injector


def run_watched(network: Network, line: Line, witness: Witness, duration_us: int) -> None:
    """Run tick by tick, and check at each tick the force that is held."""
    before_n, whole = abs(line.master.held_force_n(network.now_us)[0]), False
    for _ in range(duration_us // TICK_US):
        network.run(TICK_US)
        held_n = abs(line.master.held_force_n(network.now_us)[0])
        if network.now_us - witness.alive_us > RELEASED_US + TICK_US and held_n:
            witness.wrong.append(f"{held_n} N held in silence at {network.now_us}")
        # Once the share is whole, the stimulus itself may change within the tick.
        was_whole, whole = whole, line.master._applied._hold._whole
        if not was_whole and not whole and held_n > before_n + SLEW_N_PER_S * 2e-3:
            witness.wrong.append(f"{before_n} to {held_n} N in a tick at {network.now_us}")
        before_n = held_n


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(("sealed", "forges"), [(True, True), (True, False), (False, False)])
def test_the_force_applied_is_one_the_slave_sent_fresh_and_in_order_or_decays_as_in_silence(
    monkeypatch, sealed, forges, seed
):
    network, line, injector = attacked(sealed=sealed, forges=forges, seed=seed)
    witness = watch(monkeypatch, network)
    run_watched(network, line, witness, 8 * SECOND)
    assert witness.wrong == []
    assert injector.sent > 20
    assert witness.applied > 100
    assert line.master.failure is None


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sealed", [True, False])
def test_when_the_attacker_stops_the_session_recovers_and_the_scene_is_as_it_was(monkeypatch, sealed, seed):
    network, line, injector = attacked(sealed=sealed, forges=sealed, seed=seed)
    network.run(6 * SECOND)
    scenes = {context.scene for context in network.slave.contexts if context.steps}
    injector.quiet = True
    network.run(5 * SECOND)
    witness = watch(monkeypatch, network)
    run_watched(network, line, witness, 2 * SECOND)
    assert witness.applied > 100
    (context,) = [each for each in network.slave.contexts if each.session.number == line.master.session.number]
    assert not scenes or context.scene in scenes
    true_n = context.scene.force_n
    assert (
        abs(line.master.held_force_n(network.now_us)[0] - true_n) <= 1.05 * context.codec.law.threshold_n(true_n) + 0.05
    )
