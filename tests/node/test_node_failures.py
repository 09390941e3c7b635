"""Operators, scenes and codecs of the user's own that raise: one event, no force, an orderly end."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.events import Failed, MasterLeft
from hapticnet.protocol.messages import Code
from hapticnet.protocol.states import Ended, SessionLost
from hapticnet.samples import ForceSample, PositionSample

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


def events(node):
    return list(iter(node.next_event, None))


def test_an_operator_that_raises_is_told_once_the_force_goes_to_zero_and_the_session_ends(loopback):
    link = loopback(1, device=True, feedback="delay=20ms", forward="delay=20ms")
    while link.master.held_force_n(link.now_us)[0] < 1.0:
        link.run(5_000)
    events(link.master)
    link.master._operator = BreaksDown(link.master._operator, 0)
    failed_us = link.now_us
    link.run(SECOND)
    failure, end = events(link.master)
    assert isinstance(failure, Failed)
    assert failure.reason.startswith("the operator failed: ValueError: no hand at all (test_node_failures.py, line")
    assert end == Ended(failure.reason, refused=False)
    assert link.master.failure == link.master.end_reason == failure.reason
    table = link.master.recording.table()
    assert (table["target_n"][table["t_us"] > failed_us + 1_000] == 0.0).all()
    (left,) = [event for event in events(link.slave) if isinstance(event, MasterLeft)]
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
    events(link.master)
    link.master._applied._stream.decoder = BreaksDown(link.master._applied._stream.decoder, calls)
    link.run(SECOND)
    failure, end = events(link.master)
    assert failure.reason.startswith("the codec failed: ValueError: no hand at all (test_node_failures.py, line")
    assert end == Ended(failure.reason, refused=False)
    assert link.master.held_force_n(link.now_us)[0] == 0.0


def test_a_device_that_raises_ends_the_session_once_and_is_still_asked_for_no_force(loopback):
    link = loopback(1, device=True)
    link.run(SECOND)
    events(link.master)
    asked = []

    def exchange(displacement_m, _):
        asked.append(displacement_m)
        raise OSError("unplugged")

    link.master._rendering.fingertip.device.exchange = exchange
    link.forward = Emulator(parse_channel("loss=100%"), np.random.default_rng(0))
    link.run(SECOND)
    failure, end = events(link.master)
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
    (left,) = [event for event in events(link.slave) if isinstance(event, MasterLeft)]
    reason = left.context.session.end_reason
    assert reason.startswith("the slave closed: the scene failed: ValueError: no hand at all (test_node_failures.py,")
    assert left.context.steps == steps + 1
    end = events(link.master)[-1]
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
    (end,) = events(link.master)
    assert (end.refused, end.code) == (True, Code.FAILED)
    assert end.reason.startswith("the scene cannot be made: OSError: no such robot (test_node_failures.py, line")


def test_a_slave_that_shuts_down_is_asked_again(loopback):
    link = loopback(1)
    link.run(SECOND)
    events(link.master)
    link.slave.close("shutting down", link.now_us)
    link.run(SECOND // 10)
    assert [type(event) for event in events(link.master)][:1] == [SessionLost]
    assert link.master.report()["connections"] == 2
