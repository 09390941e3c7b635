"""Masters and slaves inside other programs, over real sockets on loopback."""

import asyncio
import itertools
import signal
import socket
import threading

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.codec.registry import codec_parameters
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.node.events import Failed, MasterJoined, MasterLeft, Paused, ScenePaused, SceneResumed, SettingsInForce
from hapticnet.protocol.states import Connected, Ended, LinkRecovered, LinkStale
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.session import in_force
from hapticnet.runtime.udp import DRAIN_US
from tests.ready import wait_until

ANY_PORT = "127.0.0.1:0"


class Spring:
    """The user's object: one method."""

    def __init__(self, axes=1):
        self.axes = axes
        self.broken = False

    def step(self, sample):
        if self.broken:
            raise OSError("the arm does not answer")
        return [200.0 * each for each in sample.position_m]


def kinds(events):
    """Return the types of events, without those of a busy machine."""
    return [type(event) for event in events if not isinstance(event, LinkStale | LinkRecovered)]


async def until_second(kind, events):
    count = 0
    async for event in events:
        yield event
        count += isinstance(event, kind)
        if count == 2:
            return


def test_on_the_programs_own_loop_all_axes_are_felt_and_events_are_iterated():
    async def play():
        async with hn.Slave(Spring(3), listen=ANY_PORT) as slave:
            async with hn.Master(slave.address, start=(0.0, 0.0, 0.0), multiplier=2.0) as master:
                assert (master.state, master.connected, master.scene) == ("established", True, "Spring")
                while master.force_n[0] < 1.9:
                    assert len(await master.exchange((0.01, 0.0, -0.005))) == 3
                assert slave.connected == ("master",)
                assert master.force_n == pytest.approx((2.0, 0.0, -1.0), rel=0.1)
                master.change(codec="raw")
                iterator = master.events()
                connected = [event async for event in until_second(SettingsInForce, iterator)]
                assert kinds(connected) == [Connected, SettingsInForce, Connected, SettingsInForce]
                assert master.node.codec.law.multiplier == 2.0, "what is not given stays"
                await master.exchange((0.01, 0.0, 0.0))
                await master.exchange((0.01, 0.0, 0.0))
            assert kinds([event async for event in iterator]) == [Ended]
            with pytest.raises(hn.UnavailableError, match="has ended: done"):
                await master.exchange(0.0)
        assert kinds([event async for event in slave.events()]) == [MasterJoined, MasterLeft, MasterJoined, MasterLeft]

    asyncio.run(play())


@pytest.mark.parametrize(("granted_hz", "device"), [(1000.0, None), (250.0, None), (250.0, "sim")])
def test_a_loop_of_exchanges_keeps_the_rate_of_the_session(granted_hz, device):
    async def play():
        async with (
            hn.Slave(Spring(), listen=ANY_PORT, fastest_rate_hz=granted_hz) as slave,
            hn.Master(slave.address, rate_hz=1000.0, device=device) as master,
        ):
            await master.exchange(0.0)
            before = master.node.positions_due, master.report()["sent"]["by_kind"]["position"]
            for step in range(100):
                await master.exchange(1e-5 * step)
            return before, (master.node.positions_due, master.report()["sent"]["by_kind"]["position"]), master.node

    before, after, node = asyncio.run(play())
    assert node.position_period_us == 1e6 / granted_hz
    assert after[0] - before[0] == 100, "each call waits for the next position, and no longer"
    assert after[1] - before[1] == 100, "each is sent"


def test_a_timer_that_is_early_or_late_ticks_at_its_rate(monkeypatch):
    master = hn.TickedMaster("127.0.0.1:9", rate_hz=1000)
    for count in range(1, 101):
        monkeypatch.setattr("hapticnet.api.master.now_us", lambda at=1000 * count + (200 if count % 2 else -200): at)
        master.tick(0.0)
    assert master.report()["ticks"] == 100
    for count in range(100):
        monkeypatch.setattr("hapticnet.api.master.now_us", lambda at=200_000 + 250 * count: at)
        master.tick(0.0)
    assert 125 <= master.report()["ticks"] <= 126, "one that is too fast sends no more positions"
    master.close()


def test_a_flood_does_not_keep_a_tick_from_its_caller(monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
        flood.bind(("127.0.0.1", 0))
        master = hn.TickedMaster(f"127.0.0.1:{flood.getsockname()[1]}", rate_hz=1000)
        master.tick(0.0)
        _, address = flood.recvfrom(2000)
        for _ in range(50):
            flood.sendto(b"garbage", address)
        clock = itertools.count(0, 100)
        monkeypatch.setattr("hapticnet.api.master.now_us", lambda: next(clock))
        taken = [0]
        for _ in range(50):
            master.tick(0.0)
            taken.append(master.report()["received"]["malformed"])
        assert taken[-1] == 50
        assert max(after - before for before, after in itertools.pairwise(taken)) <= DRAIN_US // 100
        master.close()


def test_a_program_without_asyncio_has_threads_and_its_signal_handlers_stay():
    handler = signal.getsignal(signal.SIGINT)
    with hn.ThreadedSlave("paper:1", listen=ANY_PORT) as slave, hn.ThreadedMaster(slave.address) as master:
        wait_until(lambda: master.exchange(0.025)[0] == pytest.approx(1.0))
        master.position = 0.026
        wait_until(lambda: master.force_n[0] > 1.1)
        master.change(multiplier=4.0)
        wait_until(lambda: [each["multiplier"] for each in master.report()["in_force"]] == [1.0, 4.0])
        assert kinds(master.take_events()) == [Connected, SettingsInForce, Connected, SettingsInForce]
        assert signal.getsignal(signal.SIGINT) is handler
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("hapticnet ")]
    with pytest.raises(hn.UnavailableError, match="has ended"):
        master.exchange(0.0)


def test_a_program_with_its_own_timer_ticks_both_ends():
    slave = hn.TickedSlave(Spring(), listen=ANY_PORT)
    master = hn.TickedMaster(slave.address, rate_hz=1000)
    assert master.tick(0.01) == (0.0,), "nothing waits for a session"

    def tick():
        slave.tick()
        return master.tick(0.01)[0] > 1.9

    wait_until(tick)
    assert kinds(master.take_events()) == [Connected, SettingsInForce]
    master.close()
    wait_until(lambda: slave.tick() or not slave.connected)
    assert kinds(slave.take_events()) == [MasterJoined, MasterLeft]
    slave.close()
    for closed in (slave.tick, master.tick):
        with pytest.raises(hn.SettingsError, match="is closed"):
            closed()


def test_a_function_makes_a_scene_for_each_master_and_an_object_is_touched_by_one_at_a_time():
    with (
        hn.ThreadedSlave(Spring, listen=ANY_PORT) as many,
        hn.ThreadedMaster(many.address, name="a"),
        hn.ThreadedMaster(many.address, name="b"),
    ):
        wait_until(lambda: sorted(many.connected) == ["a", "b"])
    with hn.ThreadedSlave(Spring(), listen=ANY_PORT) as one, hn.ThreadedMaster(one.address, name="a") as first:
        first.exchange(0.0)
        with pytest.raises(hn.RefusedError, match="all sessions of this slave are taken; it serves 1 at once"):
            hn.ThreadedMaster(one.address, name="b").__enter__()
        assert one.connected == ("a",)


def test_an_exception_in_step_ends_the_session_or_pauses_it_as_asked():
    scene = Spring()
    with hn.ThreadedSlave(scene, listen=ANY_PORT) as slave, hn.ThreadedMaster(slave.address, start=0.01) as master:
        wait_until(lambda: master.force_n[0] > 1.9)
        scene.broken = True
        wait_until(lambda: master.ended)
        assert "the arm does not answer" in master.ended
        wait_until(lambda: master.force_n == (0.0,))  # at the next tick
        with pytest.raises(hn.UnavailableError, match="the arm does not answer"):
            master.exchange(0.02)
    scene.broken = False
    with (
        hn.ThreadedSlave(scene, listen=ANY_PORT, on_error="pause") as slave,
        hn.ThreadedMaster(slave.address, start=0.01) as master,
    ):
        wait_until(lambda: master.force_n[0] > 1.9)
        scene.broken = True
        wait_until(lambda: master.force_n[0] == 0.0)
        assert kinds(slave.take_events()) == [MasterJoined, ScenePaused]
        scene.broken = False
        slave.resume()
        wait_until(lambda: kinds(slave.take_events()) == [SceneResumed])
        wait_until(lambda: master.force_n[0] > 1.9)
        assert master.ended is None


class Hand:
    """The user's operator."""

    def __init__(self):
        self.broken, self.felt = False, (0.0,)

    def feel(self, t_us, force_n):  # noqa: ARG002
        self.felt = force_n

    def sample(self, t_us):  # noqa: ARG002
        if self.broken:
            raise RuntimeError("no hand")
        return 0.01


@pytest.mark.parametrize(("policy", "event"), [("end", Failed), ("pause", Paused)])
def test_an_operator_of_the_programs_own_feels_and_may_fail(policy, event):
    hand = Hand()
    with (
        hn.ThreadedSlave(Spring(), listen=ANY_PORT) as slave,
        hn.ThreadedMaster(slave.address, operator=hand, on_error=policy) as master,
    ):
        wait_until(lambda: hand.felt[0] > 1.9)
        with pytest.raises(hn.SettingsError, match="an operator gives the positions"):
            master.position = 0.02
        hand.broken = True
        wait_until(lambda: master.force_n == (0.0,))
        assert kinds(master.take_events())[:3] == [Connected, SettingsInForce, event]
        assert (master.ended is None) == (policy == "pause")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": float("nan")}, "position is nan"),
        ({"start": "left"}, "position is 'left'"),
        ({"start": (0.0,) * 4}, "4 axes"),
        ({"codec": "morse"}, "morse"),
        ({"on_error": "shrug"}, "on_error is 'shrug'; choose from end, pause"),
        ({"device_takes": "z"}, "positions have one axis"),
        ({"peer_key": "x"}, "peer_key is 'x'"),
        ({"address": "here"}, "must be HOST:PORT"),
        ({"address": "192.0.2.1:47800"}, "is another host"),
        ({"operator": object()}, "has no method sample"),
        ({"device": object()}, "has neither exchange"),
    ],
)
def test_what_cannot_be_used_is_said_on_entering(arguments, message):
    if "device_takes" in arguments:
        arguments = {**arguments, "device": SimulatedDevice(PlantSettings(), np.random.default_rng(1))}
    with pytest.raises(hn.HapticnetError, match=message), hn.ThreadedMaster(**arguments):
        pass


def test_nobody_there_and_a_position_of_other_axes_are_said_in_words():
    with pytest.raises(hn.UnavailableError, match="this Master is not running"):
        _ = hn.Master().force_n
    with pytest.raises(hn.UnavailableError, match=r"no session with 127.0.0.1:9 within 0.3 s"):
        hn.ThreadedMaster("127.0.0.1:9", connect_timeout_s=0.3).__enter__()
    with hn.ThreadedSlave(Spring(), listen=ANY_PORT) as slave, hn.ThreadedMaster(slave.address) as master:
        with pytest.raises(hn.SampleError, match="position has 2 axes; this master began with 1"):
            master.position = (0.0, 0.0)
        with pytest.raises(hn.UnavailableError, match="the port is in use"):
            hn.TickedSlave(Spring(), listen=slave.address)


@pytest.mark.parametrize("suffix", [".mcap", ".csv"])
def test_a_recording_says_what_the_program_changed_and_when(tmp_path, suffix):
    file = tmp_path / f"run{suffix}"
    with (
        hn.ThreadedSlave(Spring(), listen=ANY_PORT, fastest_rate_hz=500.0) as slave,
        hn.ThreadedMaster(slave.address, start=0.005, multiplier=2.0, record=file) as master,
    ):
        wait_until(lambda: master.force_n[0] > 0.0)
        master.change(codec="level-crossing", multiplier=4.0)
        wait_until(lambda: len(master.report()["in_force"]) == 2)
        master.exchange(0.005)
    session = read_session(file)
    ((first_us, first), (second_us, second)) = in_force(session.events)
    assert session.main["t_us"][0] <= first_us < second_us <= session.main["t_us"][-1]
    assert (first["codec"], first["multiplier"], first["rate_hz"]) == ("deadband", 2.0, 500.0), "as granted"
    assert (second["codec"], second["multiplier"], second["scene"]) == ("level-crossing", 4.0, "Spring")
    assert second["parameters"] == codec_parameters(hn.make_codec("level-crossing")) != {}
    (note,) = (note for note in hn.load_recording(file).notes if "changed during this recording" in note)
    assert note.startswith(f"codec, multiplier, parameters changed during this recording, at t_us {second_us}: ")


def test_a_master_records_itself_and_presses_a_device_named_by_a_text(tmp_path):
    file = tmp_path / "run.csv"
    with (
        hn.ThreadedSlave(Spring(), listen=ANY_PORT) as slave,
        hn.ThreadedMaster(slave.address, start=0.005, device="sim", record=file) as master,
    ):
        wait_until(lambda: master.node.target_n > 0.9)
        assert "simulated device" in master.report()["device"]["description"]
    recording = hn.load_recording(file, columns="held_n")
    assert recording.force.max() == pytest.approx(1.0, rel=0.1)  # within the deadband


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"record": "run.csv"}, "record needs"), ({"device": "serial:auto"}, "a serial device needs hn.Master")],
)
def test_what_a_ticked_master_cannot_have_is_said(arguments, message):
    with pytest.raises(hn.SettingsError, match=message):
        hn.TickedMaster(**arguments)
