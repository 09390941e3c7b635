"""User code that raises and a slave that is to stop: one event, no force that is cut off, an orderly end or a pause."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.node.events import Failed, MasterLeft, Paused, ScenePaused, SceneSaid
from hapticnet.node.slave import NOTICES_AT_ONCE
from hapticnet.protocol.messages import Code
from hapticnet.protocol.states import Connected, Ended, MasterState, Noticed, Refused, SessionLost, SlaveState
from hapticnet.samples import ForceSample, PositionSample
from tests.conftest import linked, make_slave
from tests.peers import KEY, events_of

SECOND = 1_000_000


class BreaksDown:
    """An operator or a scene that works for so many calls, and then does not."""

    def __init__(self, inner, calls):
        self._inner, self._calls = inner, calls

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def _call(self, what, sample):
        self._calls -= 1
        if self._calls < 0:
            raise ValueError("no hand\nat all")
        return what(sample)

    def sample(self, t_us):
        return self._call(self._inner.sample, t_us)

    def step(self, sample):
        return self._call(self._inner.step, sample)

    def reconstruct(self, t_us, position=None, position_us=None):
        return self._call(lambda t_us: self._inner.reconstruct(t_us, position, position_us), t_us)


def test_an_operator_that_raises_is_told_once_the_force_goes_to_zero_and_the_session_ends(loopback):
    link = loopback(1, device=True, feedback="delay=20ms", forward="delay=20ms")
    while link.master.held_force_n(link.now_us)[0] < 1.0:
        link.run(5_000)
    events_of(link.master)
    link.master._operator = BreaksDown(link.master._operator, 0)
    failed_us = link.now_us
    link.run(SECOND)
    failure, end = events_of(link.master)
    assert isinstance(failure, Failed)
    assert failure.reason.startswith("the operator failed: ValueError: no hand at all (test_node_failures.py, line")
    assert end == Ended(failure.reason, refused=False)
    assert link.master.failure == link.master.end_reason == failure.reason
    table = link.master.recording.table()
    assert (table["target_n"][table["t_us"] > failed_us + 1_000] == 0.0).all()
    (left,) = events_like(link.slave, MasterLeft)
    assert left.context.session.end_reason == f"the master closed: {failure.reason}"


@pytest.mark.parametrize("position_m", [(np.nan,), (1e16,), (0.0, 0.0), ("deep",)])
def test_an_operator_whose_position_cannot_be_sent_has_failed(loopback, position_m):
    class Lost:
        axes = 1

        def sample(self, t_us):
            return PositionSample(t_us, position_m)

    link = loopback(1)
    link.run(SECOND)
    link.master._operator = Lost()
    link.run(SECOND)
    assert link.master.failure.startswith("the operator failed: ")
    assert link.master.held_force_n(link.now_us)[0] == 0.0


@pytest.mark.parametrize("calls", [0, 2])
def test_a_decoder_that_raises_ends_the_session_once(loopback, calls):
    link = loopback(1, device=True)
    link.run(SECOND)
    events_of(link.master)
    link.master._applied._stream.decoder = BreaksDown(link.master._applied._stream.decoder, calls)
    link.run(SECOND)
    failure, end = events_of(link.master)
    assert failure.reason.startswith("the codec failed: ValueError: no hand at all (test_node_failures.py, line")
    assert end == Ended(failure.reason, refused=False)
    assert link.master.held_force_n(link.now_us)[0] == 0.0


def test_a_device_that_raises_ends_the_session_once_and_is_still_asked_for_no_force(loopback):
    link = loopback(1, device=True)
    link.run(SECOND)
    events_of(link.master)
    asked = []

    def exchange(displacement_m, _):
        asked.append(displacement_m)
        raise OSError("unplugged")

    link.master._rendering.fingertip.device.exchange = exchange
    link.forward = Emulator(parse_channel("loss=100%"), np.random.default_rng(0))
    link.run(SECOND)
    failure, end = events_of(link.master)
    assert failure.reason.startswith("the device failed: OSError: unplugged (test_node_failures.py, line")
    assert end == Ended(failure.reason, refused=False)
    assert len(asked) > 200, "until the slave would have answered the CLOSE"
    assert link.master._rendering.fingertip.target_n == 0.0


@pytest.mark.parametrize("steps", [0, 100])
def test_a_scene_that_raises_ends_its_session_once_and_no_other(loopback, steps):
    link = loopback(1)
    make_scene = link.slave._admission._make_scene
    link.slave._admission._make_scene = lambda entry: BreaksDown(make_scene(entry), steps)
    link.run(SECOND)
    (left,) = events_like(link.slave, MasterLeft)
    reason = left.context.session.end_reason
    assert reason.startswith("the slave closed: the scene failed: ValueError: no hand at all (test_node_failures.py,")
    assert left.context.steps == steps + 1
    end = events_of(link.master)[-1]
    assert end == Ended(reason, refused=False, code=Code.FAILED)
    assert link.master.failure == reason
    assert link.master.report()["connections"] == 1


def test_a_codec_that_cannot_read_what_it_wrote_ends_its_session_once(loopback):
    link = loopback(1)
    link.run(SECOND // 2)
    (context,) = link.slave.contexts
    context.feedback.mirror = BreaksDown(context.feedback.mirror, 0)
    link.run(SECOND)
    assert "the force cannot be decoded: ValueError: no hand at all" in link.master.end_reason
    assert link.slave.contexts == ()


class Verbose:
    """An encoder whose payloads are too large."""

    def encode(self, *_):
        return bytes(1_200)

    def refresh(self):
        """Need nothing."""


@pytest.mark.parametrize("sealed", [False, True])
def test_a_codec_whose_payload_fits_into_no_datagram_ends_its_session(loopback, sealed):
    link = loopback(1, sealed=sealed)
    link.run(SECOND // 2)
    link.slave.contexts[0].feedback.encoder = Verbose()
    link.run(SECOND)
    assert "a payload of 1200 bytes; at most 1024 fit into a datagram" in link.master.end_reason
    assert link.slave.contexts == ()


@pytest.mark.plain
def test_a_scene_whose_force_is_not_a_number_ends_its_session(loopback):
    link = loopback(1)
    link.run(SECOND // 2)
    scene = link.slave.contexts[0].scene
    scene.step = lambda sample: ForceSample(sample.t_us, (float("nan"),))
    link.run(SECOND)
    assert "the force cannot be encoded: SampleError: stimulus is nan" in link.master.end_reason
    assert link.slave.contexts == ()


def test_a_scene_that_cannot_be_made_is_a_refusal(loopback):
    link = loopback(1)

    def fail(_):
        raise OSError("no such robot")

    link.slave._admission._make_scene = fail
    link.run(SECOND)
    (end,) = events_of(link.master)
    assert (end.refused, end.code) == (True, Code.FAILED)
    assert end.reason.startswith("the scene cannot be made: OSError: no such robot (test_node_failures.py, line")


def test_a_slave_that_shuts_down_is_asked_again(loopback):
    link = loopback(1)
    link.run(SECOND)
    events_of(link.master)
    link.slave.close("shutting down", link.now_us)
    link.run(SECOND // 10)
    assert [type(event) for event in events_of(link.master)][:1] == [SessionLost]
    assert link.master.report()["connections"] == 2


class Spring:
    """A scene that can be broken and mended."""

    name = "spring"

    def __init__(self, axes=1):
        self.axes, self.broken, self.calls = axes, False, 0

    def step(self, sample):
        self.calls += 1
        if self.broken:
            raise OSError("the arm does not answer")
        return ForceSample(sample.t_us, tuple(200.0 * each for each in sample.position_m))


class Hand:
    """An operator that can be broken and mended, and feels."""

    duration_us = None

    def __init__(self, *at_m):
        self.at_m, self.axes, self.broken, self.calls, self.felt = at_m, len(at_m), False, 0, []

    def feel(self, t_us, force_n):
        self.felt.append((t_us, force_n))

    def sample(self, t_us):
        self.calls += 1
        if self.broken:
            raise RuntimeError("no hand")
        return PositionSample(t_us, self.at_m)


def pausing(hand, scene, device=None, **settings):
    return linked(hand, lambda _: scene, device=device, slave={"on_error": "pause"}, on_error="pause", **settings)


def events_like(node, kind):
    return [event for event in events_of(node) if isinstance(event, kind)]


def test_an_operator_that_raises_is_not_asked_again_until_it_is_resumed():
    hand = Hand(0.01)
    link = pausing(hand, Spring())
    link.run(SECOND)
    assert link.master.held_n == (2.0,)
    hand.broken = True
    link.run(SECOND)
    (paused,) = events_like(link.master, Paused)
    assert paused.reason.startswith("the operator failed: RuntimeError: no hand")
    assert (link.master.paused, link.master.held_n) == (paused.reason, (0.0,))
    assert link.master.session.streaming, "the session goes on"
    hand.broken, calls = False, hand.calls
    link.run(SECOND)
    assert hand.calls == calls
    link.master.resume()
    held_n = []
    for _ in range(300):
        link.run(1000)
        held_n.append(link.master.held_n[0])
    assert held_n[-1] == 2.0
    assert max(np.diff([0.0, *held_n])) < 0.15, "the force rises at the slew limit"
    assert len(link.slave.contexts) == 1


def test_a_scene_that_raises_gives_no_force_until_it_is_resumed():
    scene = Spring()
    link = pausing(Hand(0.01), scene)
    link.run(SECOND)
    scene.broken = True
    link.run(SECOND)
    (paused,) = events_like(link.slave, ScenePaused)
    assert "OSError: the arm does not answer" in paused.reason
    assert link.master.held_n == (0.0,)
    scene.broken, calls = False, scene.calls
    link.run(SECOND)
    assert scene.calls == calls
    link.slave.resume()
    link.run(SECOND)
    assert link.master.held_n == (2.0,)


def test_what_a_scene_says_reaches_both_persons_once():
    scene = Spring()
    lines = ["the arm has\nstopped"]
    scene.next_line = lambda: lines.pop() if lines else None
    scene.report = lambda: {"stops": 1}
    link = pausing(Hand(0.01), scene)
    for _ in range(3):
        link.run(SECOND)
        link.slave.check(link.now_us)
    link.run(SECOND)
    (said,) = events_like(link.slave, SceneSaid)
    assert said == SceneSaid(link.slave.contexts[0], "the arm has stopped")
    (noticed,) = events_like(link.master, Noticed)
    assert (noticed.reason, noticed.code) == ("the arm has stopped", Code.OTHER)
    assert link.slave.contexts[0].report()["scene_report"] == {"stops": 1}
    assert link.master.held_n == (2.0,)


def test_a_scene_whose_message_raises_is_told_once_and_goes_on():
    scene = Spring()
    scene.next_line = lambda: 1 / 0
    link = pausing(Hand(0.01), scene)
    for _ in range(3):
        link.run(SECOND)
        link.slave.check(link.now_us)
    (said,) = events_like(link.slave, SceneSaid)
    assert "division by zero" in said.line
    assert link.master.held_n == (2.0,)


def test_every_axis_is_felt_held_and_recorded():
    hand = Hand(0.01, 0.0, -0.005)
    link = pausing(hand, Spring(3), record=True, record_datagrams=True)
    link.run(SECOND)
    assert link.master.held_n == (2.0, 0.0, -1.0)
    assert hand.felt[-1][1] == (2.0, 0.0, -1.0)
    assert len(hand.felt) == hand.calls
    master, slave = link.master.recording.table(), link.slave.contexts[0].recording.table()
    assert (master["held_z_n"][-1], master["position_z_m"][-1]) == (-1.0, -0.005)
    assert (slave["force_z_n"][-1], slave["held_x_n"][-1]) == pytest.approx((-1.0, 2.0), rel=1e-6)
    datagrams = link.master.datagrams.table()
    sent = link.master.session.sent
    assert datagrams["datagram_bytes"][datagrams["direction"] == 1].sum() == sent.report()["payload_bytes"]


def test_both_sides_record_the_same_times_however_long_the_masters_host_has_been_up():
    hand = Hand(0.01)
    link = pausing(hand, Spring(), record=True)
    link.now_us = link._next_tick_us = 5 * (1 << 32) + 12_345
    link.run(SECOND)
    master, slave = link.master.recording.table(), link.slave.contexts[0].recording.table()
    assert slave["t_us"][0] > 5 * (1 << 32)
    assert set(slave["t_us"]) <= set(master["t_us"])


@pytest.mark.parametrize(("takes", "target_n"), [("x", 1.2), ("z", 0.5), ("norm", 1.3)])
def test_a_device_renders_the_axis_that_it_is_declared_to_take(takes, target_n):
    device = SimulatedDevice(PlantSettings(), np.random.default_rng(1))
    link = pausing(Hand(0.006, 0.0, 0.0025), Spring(3), device, device_takes=takes)
    link.run(SECOND)
    assert link.master.target_n == pytest.approx(target_n)


MS = 1000


class Swinging:
    axes, duration_us = 1, None

    def sample(self, t_us):
        return PositionSample(t_us, (0.024 + 0.002 * np.sin(2e-6 * np.pi * t_us),))


def told_link(sealed, seed=1):
    return linked(Swinging(), seed=seed, key=KEY if sealed else None)


def test_a_running_master_is_told_and_keeps_its_force_until_it_has_finished(sealed):
    link = told_link(sealed)
    link.run(SECOND)
    held_n = link.master.held_n[0]
    assert held_n > 0.1
    link.slave.drain(link.now_us)
    assert not link.slave.drained
    for _ in range(10):
        link.run(SECOND // 2)
        link.slave.check(link.now_us)
        link.slave.account_sent(link.now_us)
        assert link.master.held_n[0] > 0.1
    told = [each for each in events_of(link.master) if isinstance(each, Noticed)]
    assert [each.code for each in told] == [Code.STOPPING], "once, although the slave repeats it"
    assert link.master.session.received.by_kind[10] >= 2
    assert link.master.report()["notices"]
    link.close()
    assert link.slave.drained
    assert link.slave.report()["sessions"][0]["superseded"] == 0


def test_the_end_of_the_time_cuts_no_force(sealed):
    link = told_link(sealed)
    link.run(SECOND)
    link.slave.drain(link.now_us)
    link.run(SECOND)
    before_n = link.master.held_n[0]
    link.slave.close("shutting down", link.now_us)
    held_n = [before_n]
    for _ in range(400):
        link.run(MS)
        held_n.append(link.master.held_n[0])
    assert held_n[-1] == 0.0
    assert max(-np.diff(held_n)) <= 1.05 * max(held_n) / 100, "it falls over a tenth of a second"
    (lost,) = [each for each in events_of(link.master) if isinstance(each, SessionLost)]
    assert "shutting down" in lost.reason


def test_a_new_master_is_refused_with_a_reason_and_asks_again(sealed):
    link = told_link(sealed)
    link.run(100 * MS)
    link.slave.drain(link.now_us)
    link.slave.close("shutting down", link.now_us)
    late = told_link(sealed, 5)
    late.slave = link.slave
    late.now_us = late._next_tick_us = link.now_us
    late.run(4 * SECOND)
    found = events_of(late.master)
    assert not [each for each in found if isinstance(each, Ended | Connected)]
    refused = [each for each in found if isinstance(each, Refused)]
    assert {each.code for each in refused} == {Code.STOPPING}
    assert [each.retry_us for each in refused][:2] == [SECOND, 2 * SECOND]
    assert late.master.session.state is MasterState.CONNECTING
    late.slave = make_slave(sealed=None)  # the next one at this address
    late.run(6 * SECOND)
    assert late.master.connected


def test_a_running_master_may_change_its_codec_while_the_slave_waits(sealed):
    link = told_link(sealed)
    link.run(SECOND)
    link.slave.drain(link.now_us)
    link.master.change(codec="raw")
    link.run(SECOND)
    assert link.master.connections == 2
    assert link.master.codec.name == "raw"


@pytest.mark.plain
def test_a_thousand_masters_are_told_a_few_at_a_time():
    """Telling all of them at once would hold up the forces of each."""
    slave = make_slave(sealed=None)

    class Told:
        seated = True

        def __init__(self):
            self.session, self.count = self, 0

    contexts = [Told() for _ in range(1000)]
    slave._contexts.update(enumerate(contexts))
    most, now_us = [], 0
    slave._notify = lambda context, *_: setattr(context, "count", context.count + 1)
    for each in contexts:
        each.state = SlaveState.OPEN
    slave._admission.takes_new = False
    for _ in range(60):
        before = sum(each.count for each in contexts)
        slave._tell_stop(now_us)
        most.append(sum(each.count for each in contexts) - before)
        now_us += SECOND // 2
    assert max(most) == NOTICES_AT_ONCE
    assert min(each.count for each in contexts) == 1
