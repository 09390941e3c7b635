"""How a scene looks, from the slave to a master that asks for it."""

import pytest

from hapticnet.channel.settings import BernoulliLoss, ChannelSettings
from hapticnet.codec.schemes.raw import Raw
from hapticnet.node.events import Noticed
from hapticnet.node.loopback import Loopback, emulated
from hapticnet.node.settings import MasterSettings
from hapticnet.protocol.wire import Kind
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.base import UserScene
from hapticnet.scene.shapes import Shape


class Pushed:
    """A ball in front of the tool, pushed along without a force."""

    def __init__(self) -> None:
        self.place_m = 0.01
        self.fails = False

    def step(self, sample: PositionSample) -> ForceSample:
        self.place_m = max(self.place_m, sample.position_m[0])
        return ForceSample(sample.t_us, (100.0 * sample.position_m[0],))

    def shapes(self) -> list[Shape]:
        if self.fails:
            raise RuntimeError("no light")
        return [Shape("plane"), Shape("sphere", (self.place_m,), (0.005,))]


class Pushing:
    axes = 1
    duration_us = None

    def sample(self, t_us: int) -> PositionSample:
        return PositionSample(t_us, (min(t_us, 1_000_000) * 3e-8,))


def link(scene: Pushed, *, loss: float = 0.0) -> Loopback:
    channel = ChannelSettings(delay_us=10_000, loss=BernoulliLoss(loss) if loss else None)
    settings = MasterSettings(codec=Raw.name)
    return emulated(Pushing(), UserScene(scene), settings, forward=channel, feedback=channel, seed=3)


def look(run: Loopback, seconds: int) -> None:
    """Let the master ask once a second, as a page does."""
    for _ in range(seconds):
        run.run(1_000_000)
        run.master.session.ask_for_shapes()


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_master_that_looks_sees_the_scene_as_it_is_now(loss):
    scene = Pushed()
    run = link(scene, loss=loss)
    look(run, 6)
    plane, ball = (run.master.shapes[place] for place in (0, 1))
    assert plane.kind == "plane"
    assert ball.at_m[0] == pytest.approx(scene.place_m, abs=1e-4) == 0.03
    assert 0 < run.master.session.drawing.packets < 5 * 30


def test_nothing_is_sent_before_a_master_looks_and_after_it_has_stopped():
    run = link(Pushed())
    run.run(1_000_000)
    assert run.master.shapes == {}
    assert run.slave.contexts[0].session.sent.by_kind[Kind.NOTICE] == 0
    run.master.session.ask_for_shapes()
    run.run(4_000_000)
    sent = run.slave.contexts[0].session.sent.by_kind[Kind.NOTICE]
    run.run(2_000_000)
    assert run.slave.contexts[0].session.sent.by_kind[Kind.NOTICE] == sent > 0


def test_a_scene_that_cannot_be_drawn_is_still_felt_and_says_why():
    scene = Pushed()
    scene.fails = True
    run = link(scene)
    look(run, 3)
    (told,) = [event for event in iter(run.master.next_event, None) if isinstance(event, Noticed)]
    assert told.reason.startswith("the scene is not drawn: Pushed.shapes raised RuntimeError: no light")
    assert run.master.held_n[0] == pytest.approx(3.0, abs=0.1)
