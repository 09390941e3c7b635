"""A hundred sessions at once through loss, reordering and duplication, whose masters roam."""

from collections import defaultdict

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.events import MasterJoined
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SessionLost
from tests.attacks.network import SECOND, Hand, Network, make_master, make_slave

MASTERS = 100
BAD = "delay=20ms,jitter=uniform:10ms,loss=30%,duplicate=20%,reorder=10%"
TIMINGS = SessionSettings(most_sessions=2 * MASTERS)
SETTLED_S = 2


def hand_of(number: int) -> Hand:
    """Return a hand that is somewhere else for each master, and moves."""
    return Hand(lambda t_us: 0.01 + 0.0002 * number + 0.005 * np.sin(t_us * 3e-6 + number))


def channel(specification: str, *seed: int) -> Emulator[bytes]:
    return Emulator(parse_channel(specification), np.random.default_rng(seed))


@pytest.mark.parametrize("sealed", [False, True])
def test_a_hundred_sessions_that_lose_repeat_reorder_and_roam_keep_their_scenes(sealed):
    network = Network(make_slave(sealed=sealed, masters=MASTERS, session=TIMINGS))
    rng = np.random.default_rng(5)
    for number in range(MASTERS):
        master = make_master(hand_of(number), sealed=sealed, number=number, rate_hz=50.0, session=TIMINGS)
        ways = (channel(BAD, number, 0), channel(BAD, number, 1))
        network.add(master, (f"10.0.0.{number}", 1000), *ways)
    scenes: dict[str, set[object]] = defaultdict(set)
    lost = 0

    def run(seconds: float) -> None:
        nonlocal lost
        network.run(round(seconds * SECOND))
        while event := network.slave.next_event():
            if isinstance(event, MasterJoined):
                scenes[event.context.session.request.name].add(event.context.scene)
        for line in network.lines:
            while event := line.master.next_event():
                lost += isinstance(event, SessionLost)

    run(1.5)
    port = 2000
    for _ in range(5):
        for line in rng.choice(np.array(network.lines, dtype=object), MASTERS // 4, replace=False):
            port += 1
            # Without keys a master is known by its host.
            host = f"10.0.{port % 250}.7" if sealed and port % 3 == 0 else line.address[0]
            network.roam(line, (host, port))
        run(0.6)
    for line in network.lines:
        line.forward, line.feedback = channel("delay=20ms", 0), channel("delay=20ms", 0)
    run(SETTLED_S)
    assert lost == 0
    assert len(scenes) == MASTERS
    assert {len(each) for each in scenes.values()} == {1}
    contexts = {context.session.number: context for context in network.slave.contexts if context.steps}
    assert len(contexts) == MASTERS
    for line in network.lines:
        context = contexts[line.master.session.number]
        true_n = context.scene.force_n
        held_n = line.master.held_force_n(network.now_us)[0]
        # 40 ms of delay at up to 1.5 N/s, and a deadband of 10 % or 0.1 N.
        assert held_n == pytest.approx(true_n, rel=0.12, abs=0.2)
