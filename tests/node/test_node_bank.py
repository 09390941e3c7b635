"""A slave with a bank sends the same bytes and keeps the same accounts as one without, whatever arrives."""

import numpy as np
import pytest

from hapticnet.node.compiled_slave import SHORTEST_TICK_US
from hapticnet.protocol import seal, seal_steps
from hapticnet.protocol.repair import RepairSettings
from hapticnet.protocol.wire import SEALED, Kind, pack
from hapticnet.scene.scene import Scene
from hapticnet.scene.tissue import Tissue
from tests.node.adversary import Adversary
from tests.node.twins import MASTERS, Crowd, Twins

NETWORKS = {
    "perfect": "perfect",
    "delay and jitter": "delay=8ms,jitter=normal:2ms",
    "losses in bursts": "delay=12ms,loss=gilbert:2%,25%",
    "reordering and copies": "delay=5ms,jitter=normal:3ms,order=free,duplicate=10%,reorder=5%:4ms,loss=2%",
}


def finish(twins, crowd):
    """Compare the accounts before and after the end of all sessions."""
    twins.check_reports()
    twins.close(crowd.slaves_us)
    twins.check_reports()


@pytest.mark.parametrize("network", NETWORKS)
def test_compiled_sessions_send_the_same_bytes(network):
    twins = Twins(1)
    crowd = Crowd(twins, 1, network=NETWORKS[network])
    crowd.run(1500)
    assert len(twins.banked._bank) == 12
    finish(twins, crowd)
    assert twins.datagrams > 5_000


@pytest.mark.parametrize("seed", range(3))
def test_an_adversary_changes_nothing_of_that(seed):
    twins = Twins(seed)
    crowd = Crowd(twins, seed, network="delay=4ms,jitter=normal:2ms,order=free,loss=3%", spoil=Adversary(seed))
    for jump_us in (0, 700_000, -300_000, 5_000_000, -5_000_000, 0):
        crowd.jump_us += jump_us
        crowd.run(250)
    finish(twins, crowd)


def test_the_functions_do_the_same_as_plain_python():
    twins = Twins(4, is_compiled=False)
    crowd = Crowd(twins, 4, masters=MASTERS[:6], network="delay=4ms,loss=3%,duplicate=2%", spoil=Adversary(4))
    crowd.run(150)
    finish(twins, crowd)


def test_sequence_numbers_wrap():
    twins = Twins(5, first_sequence=2**32 - 200)
    crowd = Crowd(twins, 5, masters=MASTERS[:6], sealed=(False,), network="delay=4ms,loss=3%")
    crowd.run(700)
    assert len(twins.banked._bank) == 6
    finish(twins, crowd)


def test_a_new_key_begins_in_python(monkeypatch):
    for module in (seal, seal_steps):
        monkeypatch.setattr(module, "EPOCH_BITS", 6)
    monkeypatch.setattr("hapticnet.node.bank_steps.EPOCH_BITS", 6)
    monkeypatch.setattr("hapticnet.node.compiled_slave.SHORTEST_STAY_US", 0)
    twins = Twins(6, is_compiled=False)
    crowd = Crowd(twins, 6, masters=MASTERS[:6], sealed=(True,), network="delay=4ms,loss=3%")
    crowd.run(400)
    assert len(twins.banked._bank) == 6
    finish(twins, crowd)


@pytest.mark.parametrize("repair", [{"replaces": False}, {"repeats": False}, {"paces": False}])
def test_all_settings_of_repair_are_used(repair):
    twins = Twins(7, repair=RepairSettings(**repair))
    crowd = Crowd(twins, 7, masters=MASTERS[:6], network="delay=12ms,loss=gilbert:5%,25%")
    crowd.run(600)
    finish(twins, crowd)


KINDS = (
    {},
    {"viscosity_n_s_per_m": 1.0},
    {"recovery_time_s": 0.2},
    {"shaft_friction_n": 0.2},
    {"stiffening_per_m": 90.0},
)


def scenes(seed):
    """Return a maker of scenes of 1 to 17 layers of any kind, the same ones for the same seed."""
    rng = np.random.default_rng(seed)

    def make(_):
        properties = KINDS[int(rng.integers(len(KINDS)))] if rng.random() < 0.5 else {}
        layers = [
            Tissue(
                name=f"layer {number}",
                rest_position_m=0.002 * number,
                stiffness_n_per_m=float(rng.uniform(100.0, 900.0)),
                breach_force_n=float(rng.uniform(0.2, 2.0)),
                **properties,
            )
            for number in range(int(rng.integers(1, 18)))
        ]
        return Scene(layers)

    return make


def test_scenes_with_other_tissues_stay_outside():
    twins = Twins(8, make_scene=scenes)
    crowd = Crowd(twins, 8, network="delay=4ms,loss=3%")
    crowd.run(900)
    assert 4 <= len(twins.banked._bank) < 12
    finish(twins, crowd)


def test_sessions_that_fall_silent_expire_and_their_places_are_used_again():
    twins = Twins(9, keep_us=1_000_000, most_sessions=8)
    crowd = Crowd(twins, 9, masters=MASTERS[:6], network="delay=2ms")
    for _ in range(4):
        crowd.run(300)
        crowd.ends.append(crowd.ends.pop(0))
        muted = crowd.ends[-4:]
        crowd.spoil = lambda batch, _, muted=muted: [each for each in batch if each[1] not in {end[0] for end in muted}]
        crowd.run(1_100)
        crowd.spoil = lambda batch, _: batch
    finish(twins, crowd)
    ended = {each["end_reason"] for each in twins.plain.report()["sessions"]}
    assert "nothing arrived from the master" in ended


def test_a_scene_is_continued_where_a_bank_has_left_it():
    twins = Twins(10)
    crowd = Crowd(twins, 10, masters=MASTERS[:6], network="delay=2ms")
    crowd.run(500)
    lost = range(6)
    crowd.spoil = lambda batch, _: [each for each in batch if each[1][1] not in lost]
    crowd.run(1_500)  # these masters ask for new sessions, which do not arrive
    crowd.spoil = lambda batch, _: batch
    crowd.run(1_500)
    finish(twins, crowd)
    assert sum(each["continues"] is not None for each in twins.plain.report()["sessions"]) >= 3


def test_a_session_that_is_often_unusual_stays_outside_for_longer_and_longer():
    twins = Twins(11)
    crowd = Crowd(twins, 11, masters=MASTERS[:1], sealed=(False,))
    inside = []
    for _ in range(8):
        crowd.run(40)
        number = twins.banked.stations[0].session.number
        astray = pack(Kind.POSITION, number, 1 << 31, b"")
        twins.to([(astray, crowd.ends[0][0])], crowd.slaves_us)
        crowd.run(100)
        inside.append(len(twins.banked._bank))
    assert inside[:2] == [1, 1]
    assert 0 in inside
    crowd.run(2_600)
    assert len(twins.banked._bank) == 1
    finish(twins, crowd)


@pytest.mark.parametrize("kind", Kind)
def test_what_does_not_open_costs_a_sealed_session_nothing(kind):
    twins = Twins(12)
    crowd = Crowd(twins, 12, masters=MASTERS[:1], sealed=(True,))
    crowd.run(200)
    (station,) = twins.banked.stations
    assert station in twins.banked._bank
    for sequence in (0, 1, 300, 1 << 20, 1 << 31):
        forged = pack(kind, station.session.number, sequence, bytes(40), SEALED)
        for address in (crowd.ends[0][0], ("stranger", 1)):
            twins.banked.receive_datagrams([(forged, address)], crowd.slaves_us)
    assert station in twins.banked._bank


def test_a_session_that_expires_is_not_stepped_once_more():
    twins = Twins(12)
    crowd = Crowd(twins, 12, masters=MASTERS[4:6], network="delay=4ms")
    crowd.run(700)
    before = [each["steps"] for each in twins.plain.report()["sessions"]]
    twins.tick(crowd.slaves_us + 31_000_000)  # the process was stopped: scenes are due, and so is the end
    assert twins.plain.session_count == 0
    assert [each["steps"] for each in twins.plain.report()["sessions"]] == before
    twins.check_reports()


@pytest.mark.parametrize("hours", [-2, 2])
def test_the_timer_of_a_bank_follows_a_clock_that_jumps(hours):
    twins = Twins(13)
    crowd = Crowd(twins, 13, masters=MASTERS[4:6], network="delay=4ms")
    crowd.run(500)
    crowd.jump_us += hours * 3_600_000_000
    twins.plain.next_timer_us = lambda: None  # only the bank asks for ticks
    crowd.run(300)
    del twins.plain.next_timer_us
    assert len(twins.banked._bank) == 4
    late_us = twins.banked.next_timer_us() - twins.plain.next_timer_us()
    assert late_us <= SHORTEST_TICK_US
    finish(twins, crowd)


def test_answers_that_were_not_sent_wait_for_the_next_ones():
    twins = Twins(14, most_sessions=2)
    crowd = Crowd(twins, 14, masters=MASTERS[:1], network="delay=2ms")
    crowd.run(300)
    assert len(twins.banked._bank) == 2
    batch = []
    crowd.spoil = lambda arrives, _: batch.extend(arrives) or []
    crowd.run(20)
    for datagram in batch:
        for slave in twins.slaves:
            slave.receive_datagrams([datagram], crowd.slaves_us)
    crowd._back(twins._collect(crowd.slaves_us))
    crowd.spoil = lambda arrives, _: arrives
    crowd.run(100)
    finish(twins, crowd)
