"""Vibration beside force: felt in milliseconds, within its budget, and a lost frame costs only itself."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.channel.spec import parse_channel
from hapticnet.codec.vibration import FRAME, FRAME_US, RATE_HZ, VibrationCodec
from hapticnet.device.user import as_user_device
from hapticnet.device.voice_coil import LARGEST_M_S2, RESONANCE_HZ, VoiceCoil
from hapticnet.errors import UserCodeError
from hapticnet.node.loopback import emulated
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.node.vibration import SAVED_S, VibrationPlayer, VibrationSender
from hapticnet.protocol.messages import Force, Vibration
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.wire import Kind
from hapticnet.scene.base import UserScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene, make_scene
from tests.peers import GRANT, REQUEST, HandSlave, Still

PERFECT = parse_channel("perfect")
MS = 1000


class Rough:
    """A scene that vibrates at 200 Hz, and noise beside it, whatever is done."""

    axes, amplitude = 1, 4.0

    def step(self, _sample):
        return 0.0

    def vibration(self, start_us, samples, rate_hz):
        times_s = 1e-6 * start_us + np.arange(samples) / rate_hz
        noise = np.random.default_rng(start_us).normal(0.0, 0.3, samples)
        return self.amplitude * (np.sin(2.0 * math.pi * 200.0 * times_s) + noise)


def frame(number, amplitude=5.0):
    """Return a frame of a sinusoid of 200 Hz that goes on from one number to the next, and its payload."""
    times_s = (number * FRAME + np.arange(FRAME)) / RATE_HZ
    payload = VibrationCodec().encode((amplitude * np.sin(2.0 * math.pi * 200.0 * times_s)).tolist())
    return VibrationCodec().decode(payload), payload


class Kept:
    """A shaker that keeps what it is asked for."""

    def __init__(self):
        self.samples = []

    def vibrate(self, samples, rate_hz):
        assert rate_hz == RATE_HZ
        assert samples
        self.samples += samples


def play(numbers, *, until_us, arrival_us=None, again=False):
    """Return the samples played of frames with these numbers, which arrive 20 ms after they begin."""
    shaker = Kept()
    player = VibrationPlayer(shaker, 0.1, record=False)
    due = {number * FRAME_US + 20 * MS + (arrival_us or {}).get(number, 0): number for number in numbers}
    for now_us in range(0, until_us, MS):
        if now_us in due:
            number = due[now_us]
            player.receive(number * FRAME_US, frame(number)[1], frame(number - 1)[1] if again else None, now_us)
        player.drive(now_us, mute=False)
    return np.array(shaker.samples), player


@pytest.mark.parametrize("delay_ms", [0, 20, 80])
def test_a_breach_is_felt_above_100_hz_within_a_frame_of_the_force(delay_ms):
    link = hn.virtual_link(
        scene="membranes", vibration=True, forward=f"delay={delay_ms}ms", feedback=f"delay={delay_ms}ms"
    )
    link.run(seconds=8.0)
    steps, played = link.slave_samples(), link.vibration_samples()
    broken_us = steps["t_us"][1:][np.diff(steps["breaches"]) > 0][0]
    felt = played["t_us"] >= broken_us
    begins = played["t_us"][felt & (np.abs(played["played_m_s2"]) > 1.0)][0]
    assert begins - broken_us <= 2 * delay_ms * MS + FRAME_US + 2 * MS
    ring = played["felt_m_s2"][(played["t_us"] >= begins) & (played["t_us"] < begins + 40 * MS)]
    spectrum = np.abs(np.fft.rfft(ring, 1024))
    assert np.fft.rfftfreq(1024, 1.0 / RATE_HZ)[spectrum.argmax()] > 100.0
    assert np.abs(ring).max() > 4.0


def test_every_byte_is_accounted_for_under_loss():
    link = hn.virtual_link(scene=Rough(), vibration=True, forward="delay=10ms", feedback="delay=10ms,loss=10%", seed=2)
    link.run(seconds=5.0)
    report = link.report()
    sent, received = report.slave["sent"], report.master["received"]
    assert sent["by_kind"]["vibration"] == report.slave["vibration"]["frames"] > 400
    in_flight = sent["packets"] - (received["packets"] - 1) - received["lost"]
    assert 0 <= in_flight <= 4
    assert received["malformed"] == received["stray"] == 0


def test_during_loss_most_lost_frames_come_again_with_the_next_one():
    link = hn.virtual_link(scene=Rough(), vibration=True, forward="delay=10ms", feedback="delay=10ms,loss=20%", seed=3)
    link.run(seconds=10.0)
    report = link.report()
    assert report.master["vibration"]["frames"] > 0.92 * report.slave["vibration"]["frames"]
    assert report.master["received"]["by_kind"]["vibration"] < 0.85 * report.slave["vibration"]["frames"]


def traffic(scene, **given):
    """Return what both ends of a run have sent, and what the master held."""
    link = hn.virtual_link(scene=scene, feedback="delay=5ms,loss=2%", seed=4, **given)
    link.run(seconds=4.0)
    report = link.report()
    return report.slave["sent"], report.master["sent"], link.master_samples()["held_n"].tobytes()


def test_vibration_that_is_not_asked_for_changes_no_byte():
    settings = find_scene("membranes")
    silent = [replace(tissue, ring_hz=0.0, touch_per_s=0.0, breach_m_s2=0.0) for tissue in settings.tissues]
    plain = Scene(silent, name=settings.name)
    assert plain.vibration is None
    assert traffic(make_scene(settings)) == traffic(plain)


def test_a_scene_that_does_not_vibrate_grants_none():
    link = hn.virtual_link(scene="paper:1", vibration=True)
    link.run(seconds=2.0)
    report = link.report()
    assert "vibration" not in report.slave
    assert report.master["vibration"]["frames"] == 0
    assert traffic("paper:1", vibration=True)[0] == traffic("paper:1")[0]


def test_frames_are_played_without_a_gap_and_as_they_were_decoded():
    samples, player = play(range(6), until_us=200 * MS)
    decoded = np.concatenate([frame(number)[0] for number in range(6)])
    assert samples[3 : 6 * FRAME] == pytest.approx(decoded[3:])
    assert samples[:3] == pytest.approx(decoded[:3] * (0.25, 0.5, 0.75))
    assert player.report() == {"frames": 6, "late": 0, "wait_ms": 20.0}


def test_a_lost_frame_costs_only_itself_and_fades_instead_of_repeating():
    whole, _ = play(range(6), until_us=200 * MS)
    samples, _ = play([0, 1, 2, 4, 5], until_us=200 * MS)
    gap = slice(3 * FRAME, 4 * FRAME)
    assert samples[: 3 * FRAME] == pytest.approx(whole[: 3 * FRAME])
    assert samples[4 * FRAME + 3 : 6 * FRAME] == pytest.approx(whole[4 * FRAME + 3 : 6 * FRAME])
    faded = np.abs(samples[gap])
    assert faded[0] == pytest.approx(0.75 * abs(whole[3 * FRAME - 1]))
    assert (np.diff(faded) <= 0.0).all(), "nothing comes back before the next frame"
    assert faded[8] < 0.1 * abs(whole[3 * FRAME - 1])


def test_a_lost_frame_that_comes_again_is_played():
    samples, player = play([0, 1, 2, 4, 5], until_us=250 * MS, again=True)
    assert player.report()["frames"] == 6
    assert player.report()["wait_ms"] == 30.0, "from then on, there is time for the next one"
    lost = frame(3)[0]
    correlated = np.correlate(samples, lost, "valid") / (lost @ lost)
    assert correlated.max() == pytest.approx(1.0, abs=0.05)


def test_after_the_last_frame_the_shaker_comes_to_rest():
    samples, player = play(range(2), until_us=300 * MS)
    assert len(samples) < 2 * FRAME + 60
    assert samples[-1] == 0.0
    assert player.played_m_s2 == []


def test_frames_that_come_unevenly_cost_one_gap():
    late = dict.fromkeys(range(2, 10), 8 * MS)
    samples, player = play(range(10), until_us=300 * MS, arrival_us=late)
    assert player.report() == {"frames": 10, "late": 0, "wait_ms": 28.0}
    tail = np.concatenate([frame(number)[0] for number in range(3, 10)])
    assert (
        min(np.abs(samples[begin : begin + len(tail)] - tail).max() for begin in range(len(samples) - len(tail))) < 1e-9
    ), "those after the first late one are whole"


def test_one_frame_that_is_far_too_late_costs_itself():
    _, player = play(range(10), until_us=400 * MS, arrival_us={4: 75 * MS})
    assert player.report() == {"frames": 9, "late": 1, "wait_ms": 20.0}


def test_a_stale_link_and_a_pause_mute():
    shaker = Kept()
    player = VibrationPlayer(shaker, 0.1, record=False)
    player.receive(0, frame(0)[1], None, 20 * MS)
    for now_us in range(20 * MS, 25 * MS, MS):
        player.drive(now_us, mute=False)
    assert np.abs(shaker.samples).max() > 1.0
    shaker.samples.clear()
    for now_us in range(25 * MS, 60 * MS, MS):
        player.drive(now_us, mute=True)
    assert (np.diff(np.abs(shaker.samples)) <= 0.0).all()
    assert shaker.samples[-1] == 0.0


@pytest.mark.parametrize("budget", [800.0, 1500.0, 2000.0, 20_000.0])
def test_the_budget_is_never_exceeded(budget):
    session = SlaveSession(0x10000, REQUEST, SessionSettings(), rate_hz=1000.0, first_sequence=0, now_us=0)
    scene = Rough()
    scene.amplitude = 30.0
    sender = VibrationSender(scene.vibration, session, budget, 0.1)
    taken, total = [], 0
    for now_us in range(0, 3_000_000, MS):
        total += sum(map(len, sender.datagrams(now_us, 0, now_us)))
        taken.append(total)
    for begin in range(0, 3000, 100):
        for end in range(begin + 100, 3000, 100):
            most = budget * (SAVED_S + 1e-3 * (end - begin)) + 30  # of the first datagram, only the payload was counted
            assert taken[end] - taken[begin] <= most
    report = sender.report()
    assert report["frames"] + report["dropped"] == 299
    if budget > 10_000.0:
        assert report["coarser"] == report["dropped"] == 0
    else:
        assert report["coarser"] > 0
        assert total > 0.8 * 3.0 * budget, "and it is used"


def connected(grant=GRANT, **settings):
    node = MasterNode(Still(), None, MasterSettings(**settings), np.random.default_rng(5))
    return node, HandSlave(node).connect(grant=grant)


def test_garbage_is_counted_and_the_session_goes_on():
    node, slave = connected(GRANT._replace(vibration=True), vibration=True)
    assert node.vibration is not None
    rng = np.random.default_rng(6)
    payloads = [b"", *(rng.bytes(int(rng.integers(0, 120))) for _ in range(200))]
    for sequence, payload in enumerate(payloads, start=1):
        node.tick(MS * sequence)
        slave.say(Kind.VIBRATION, sequence, (MS * sequence, payload, payload), MS * sequence)
        node.drive(MS * sequence)
    malformed, report = node.session.received.malformed, node.vibration.report()
    assert malformed > 40
    assert malformed + report["frames"] + report["late"] >= len(payloads)
    node.tick(300 * MS)
    slave.say(Kind.FORCE, 300, Force(300 * MS, b"\x3f\x80\0\0"), 300 * MS)
    node.drive(300 * MS)
    assert node.held_n == pytest.approx((1.0,), abs=0.2) or node.received_n == (1.0,)
    assert not node.finished


def test_a_long_texture_does_not_wait_for_ever_for_frames_that_were_once_late():
    late = dict.fromkeys(range(20, 23), 25 * MS)
    samples, player = play(range(450), until_us=4600 * MS, arrival_us=late)
    assert player.report()["late"] == 0
    assert 20.0 <= player.report()["wait_ms"] <= 35.0
    whole = np.concatenate([frame(number)[0] for number in range(400, 440)])
    begins = len(samples) - 50 * FRAME - 200
    off = [np.abs(samples[begin : begin + len(whole)] - whole).max() for begin in range(begins - 400, begins + 400)]
    assert min(off) < 1e-9, "later frames are whole"


def test_an_outage_of_the_link_costs_no_vibration_long_after_it():
    late = {number: (420 - 9 * number) * MS for number in range(10, 47)}  # all arrive from 450 ms on, 1 ms apart
    samples, player = play(range(130), until_us=1300 * MS, arrival_us=late)
    assert player.report()["late"] >= 2, "the outage is longer than one wait"
    assert np.count_nonzero(samples) >= 70 * FRAME, "all but the outage is played"


def test_ticks_closer_than_samples_ask_for_none_twice():
    shaker = Kept()
    player = VibrationPlayer(shaker, 0.1, record=True)
    player.receive(0, frame(0)[1], None, 20 * MS)
    for now_us in range(20 * MS, 60 * MS, 100):
        player.drive(now_us, mute=False)
    assert shaker.samples[3:FRAME] == pytest.approx(frame(0)[0][3:].tolist())
    assert (np.diff(player.recording.table()["t_us"]) > 300.0).all()


def test_a_flood_of_frames_is_not_read():
    player = VibrationPlayer(Kept(), 0.1, record=False)
    for number in range(1000):
        player.receive(number * FRAME_US, frame(number % 8)[1], None, 30 * MS)
    assert player.report()["late"] >= 984


def test_vibration_without_a_grant_is_stray():
    node, slave = connected()
    node.tick(MS)
    slave.say(Kind.VIBRATION, 1, (MS, frame(0)[1]), 2 * MS)
    assert node.session.received.stray == 1
    assert node.vibration is None


def test_vibration_is_no_sign_of_life_and_must_be_fresh():
    node, slave = connected(GRANT._replace(vibration=True), vibration=True)
    for step in range(1, 400):
        node.tick(MS * step)
        slave.say(Kind.VIBRATION, step, Vibration(MS * step, frame(step)[1])[:2], MS * step)
    assert node.session.state.value == "stale"
    before = node.session.received.too_old
    slave.say(Kind.VIBRATION, 400, (10_000 * MS, frame(0)[1]), 400 * MS)
    assert node.session.received.too_old == before + 1, "no such position was sent"


@pytest.mark.parametrize("made", [[1.0], "text", [math.nan] * FRAME, 5.0, [[0.0] * FRAME], OSError("unplugged")])
def test_what_a_scene_must_not_return_ends_the_session_with_a_reason(made):
    scene = Rough()

    def vibration(*_):
        if isinstance(made, Exception):
            raise made
        return made

    scene.vibration = vibration
    link = emulated(
        Still(), UserScene(scene), MasterSettings(vibration=True), forward=PERFECT, feedback=PERFECT, seed=1
    )
    link.run(500 * MS)
    why = "Rough.vibration raised" if isinstance(made, OSError) else "vibration must return 28 finite accelerations"
    assert why in link.master.end_reason


class Pad:
    """A user's device that vibrates."""

    def __init__(self):
        self.samples = []

    def apply(self, _force_n, _now_us):
        return None

    def vibrate(self, samples, _rate_hz):
        self.samples += samples
        if len(self.samples) > 400:
            raise OSError("unplugged")


def test_a_device_of_the_user_plays_and_its_fault_ends_the_session():
    pad = Pad()
    link = emulated(
        Still(), UserScene(Rough()), MasterSettings(vibration=True), forward=PERFECT, feedback=PERFECT, seed=1
    )
    link.master = MasterNode(Still(), as_user_device(pad), MasterSettings(vibration=True), np.random.default_rng(7))
    link.run(1_000 * MS)
    assert np.abs(pad.samples).max() > 3.0
    assert link.master.failure is not None
    assert "Pad.vibrate" in link.master.failure
    with pytest.raises(UserCodeError, match="unplugged"):
        as_user_device(pad).vibrate([0.0], RATE_HZ)


def test_the_voice_coil_follows_above_its_resonance_and_gives_less_below():
    def gain(frequency_hz):
        coil = VoiceCoil()
        samples = np.sin(2.0 * math.pi * frequency_hz * np.arange(RATE_HZ) / RATE_HZ)
        coil.vibrate(samples.tolist(), float(RATE_HZ))
        return np.abs(coil.moved_m_s2[RATE_HZ // 2 :]).max()

    assert gain(300.0) == pytest.approx(1.0, abs=0.1)
    assert gain(0.25 * RESONANCE_HZ) < 0.1
    coil = VoiceCoil()
    coil.vibrate([1e6], float(RATE_HZ))
    assert coil.moved_m_s2 == [LARGEST_M_S2]
