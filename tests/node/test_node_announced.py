"""A scene announces the contact ahead: the law holds whatever it says, and errors last no longer than a round trip."""

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.codec.registry import every_codec
from hapticnet.device.user import UserActuator
from hapticnet.measure.metrics import error_report
from hapticnet.node.decoders import AnnouncedDecoder
from hapticnet.node.feedback import AnnouncingEncoder
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import Kind, unpack
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.ahead import LayerAhead, stiffest_at
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.scene.sources import as_touchable, find_scene
from tests.conftest import linked
from tests.peers import Still

CODECS = every_codec()
SECOND = 1_000_000
DELAY_US = 50_000
LAW = WeberLaw()
CODEC_NAMES = ["raw", "deadband", "linear-predictive", "adaptive-predictive", "motion-predictive"]


class Telling:
    """A scene that announces what it is given, whatever it is."""

    name, axes, breaches = "telling", 1, 0

    def __init__(self, scene, tell=lambda layers: layers):
        self.scene, self.tell = scene, tell

    def step(self, sample):
        return self.scene.step(sample)

    def ahead(self):
        return self.tell(self.scene.ahead())


class Cut:
    """A channel that can be cut, and notes when it carried a FORCE."""

    def __init__(self, spec, seed):
        self.channel = Emulator(parse_channel(spec), np.random.default_rng(seed))
        self.due, self.next_timer_us = self.channel.due, self.channel.next_timer_us
        self.cut, self.forces_us = False, []

    def push(self, packet, size, now_us):
        if unpack(packet).kind is Kind.FORCE:
            self.forces_us.append(now_us)
        if not self.cut:
            self.channel.push(packet, size, now_us)


def paper():
    return Scene(find_scene("paper:1").tissues, name="paper:1")


def link_with(make_scene, spec="delay=50ms", *, operator=None, announces=True, seed=1, **chosen):
    operator = operator or ScriptedOperator(InsertionSettings(insertions=1), np.random.default_rng(seed))
    settings = {"announced": True, "record": True, **chosen}
    link = linked(operator, lambda _: make_scene(), slave={"announces": announces}, **settings)
    link.forward, link.feedback = Cut(spec, [seed, 1]), Cut(spec, [seed, 2])
    return link


def felt(link):
    """Return the error of what was held against the true force of each tick."""
    table, scene = link.master.recording.table(), paper()
    true = [
        scene.step(PositionSample(int(t), (x,))).force_n
        for t, x in zip(table["t_us"], table["position_m"], strict=True)
    ]
    return error_report(LAW, np.array(true), table["held_n"][:, None])


def account(link):
    return link.slave.contexts[-1].report()["announced"]


def forces(link):
    return link.slave.contexts[-1].session.sent.by_kind[Kind.FORCE]


layers = st.builds(
    LayerAhead,
    st.floats(-0.01, 0.07),
    st.floats(1.0, 3000.0),
    st.one_of(st.just(math.inf), st.floats(0.1, 5.0)),
    st.one_of(st.just(0.0), st.floats(0.1, 50.0)),
    pierced=st.booleans(),
)


@given(
    st.sampled_from(CODEC_NAMES),
    st.lists(st.one_of(st.none(), st.just("truth"), st.lists(layers, max_size=3)), min_size=1, max_size=8),
    st.lists(st.floats(-0.005, 0.07), min_size=2, max_size=5),
    st.integers(0, 2**32),
)
@settings(max_examples=80, deadline=None)
def test_without_loss_and_delay_the_law_holds_at_every_sample_whatever_the_scene_announces(name, said, stops, seed):
    rng = np.random.default_rng(seed)
    scene, codec, index = paper(), CODECS[name](), 0

    def tell(true):
        what = said[index // 20 % len(said)]
        return true if what == "truth" else what

    look_ahead, stiffest_n_per_m = Telling(scene, tell).ahead, stiffest_at(1000.0)
    encoder = AnnouncingEncoder(codec.encoder(1), LAW, 1, look_ahead, stiffest_n_per_m)
    mirror = AnnouncedDecoder(codec.decoder(1), 1, stiffest_n_per_m)
    for a, b in itertools.pairwise(stops):
        for k in range(40):
            t_us, x = 1000 * index, (a + (b - a) * k / 40 + float(rng.normal(0.0, 2e-5)),)
            force_n = scene.step(PositionSample(t_us, x)).force_n
            if rng.random() < 0.02:
                encoder.refresh()
            payload = encoder.encode(t_us, force_n, x)
            mirror.move(t_us, x)
            if payload is not None:
                mirror.decode(t_us, payload)
            (applied_n,) = mirror.reconstruct(t_us, x, t_us)
            assert abs(force_n[0] - applied_n) <= LAW.threshold_n(abs(applied_n)) * (1 + 1e-12), index
            assert encoder.on_model == mirror.on_model
            index += 1


@pytest.mark.parametrize("spec", ["delay=50ms", "delay=25ms,jitter=normal:5ms,loss=5%"])
def test_what_is_announced_is_felt_without_delay(spec):
    link = link_with(paper, spec)
    link.run(6 * SECOND)
    assert felt(link).exceed_jnd_fraction <= 0.02
    assert link.slave.contexts[0].report()["breaches"] == 3
    assert account(link)["corrections"] <= 2
    assert forces(link) <= 30
    without = link_with(paper, spec, announced=False)
    without.run(6 * SECOND)
    assert felt(without).exceed_jnd_fraction > 0.1
    assert without.slave.contexts[0].report()["announced"] is None


@pytest.mark.parametrize("spec", ["delay=50ms", "delay=50ms,loss=5%"])
def test_few_positions_are_enough_for_what_is_announced(spec):
    link = link_with(paper, spec, positions="line")
    link.run(6 * SECOND)
    assert link.slave.contexts[0].grant.position_share > 0.0
    assert felt(link).exceed_jnd_fraction <= 0.02
    assert link.slave.contexts[0].report()["breaches"] == 3
    assert link.master.session.sent.by_kind[Kind.POSITION] < 0.1 * link.master.ticks
    assert account(link)["corrections"] <= 2


@pytest.mark.parametrize(
    ("announced", "announces", "scene"),
    [(False, True, paper), (True, False, paper), (True, True, lambda: Silent())],
    ids=["not asked for", "refused", "a scene that cannot"],
)
def test_either_side_can_do_without(announced, announces, scene):
    link = link_with(scene, announced=announced, announces=announces)
    link.run(3 * SECOND)
    assert link.slave.contexts[0].grant.announced is False
    assert link.master.report()["ticks_on_model"] == 0
    assert link.slave.contexts[0].report()["exceed_jnd_fraction"] == 0.0


class Silent:
    """A scene without ``ahead``."""

    name, axes, breaches = "silent", 1, 0

    def step(self, sample):
        return ForceSample(sample.t_us, (100.0 * sample.position_m[0],))


LIES = {
    "twice as stiff": lambda each: each._replace(stiffness_n_per_m=2 * each.stiffness_n_per_m),
    "half as stiff": lambda each: each._replace(stiffness_n_per_m=0.5 * each.stiffness_n_per_m),
    "1 mm nearer": lambda each: each._replace(surface_m=each.surface_m - 1e-3),
    "a wall": lambda each: each._replace(stiffness_n_per_m=9e3, breach_force_n=math.inf),
}


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_a_wrong_model_is_replaced_within_a_round_trip(lie):
    hand = Still(0.0)
    link = link_with(lambda: Telling(paper(), lambda true: tuple(map(lie, true))), operator=hand)
    link.run(SECOND)
    hand.place_m = 0.0225
    caught_us = None
    for _ in range(300):
        link.run(1000)
        if not link.master.on_model:
            caught_us = link.now_us - SECOND
            break
    assert caught_us is not None
    assert caught_us <= 2 * DELAY_US + 3000
    link.run(100_000)
    (true_n,) = paper().step(PositionSample(0, (0.0225,))).force_n
    assert link.master.held_n == pytest.approx((true_n,), rel=1e-6)
    link.run(2 * SECOND)
    assert not link.master.on_model, "it is not believed again while it is wrong"


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        (lambda _: [LayerAhead(0.02, math.nan)], "stiffness_n_per_m"),
        (lambda _: [LayerAhead(math.inf, 100.0)], "surface_m"),
        (lambda _: ["a wall"], "str"),
        (lambda _: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_what_cannot_be_announced_is_counted_and_forces_are_served(said, fault):
    link = link_with(lambda: Telling(paper(), said))
    link.run(3 * SECOND)
    assert link.master.connected
    assert link.master.report()["ticks_on_model"] == 0
    assert account(link)["unusable"] > 0
    assert fault in account(link)["fault"]
    assert link.slave.contexts[0].report()["exceed_jnd_fraction"] == 0.0


def test_a_wall_too_stiff_to_render_is_left_out():
    link = link_with(lambda: Telling(paper(), lambda true: [LayerAhead(0.03, 1e6), *true]), "perfect")
    link.run(3 * SECOND)
    assert account(link)["unusable"] == 0
    assert account(link)["left_out"] > 0
    assert account(link)["fault"].startswith("left out: layers ahead of 1e+06 N/m together; at most 10000 N/m")
    assert felt(link).exceed_jnd_fraction == 0.0


@pytest.mark.parametrize(("stiffening", "is_announced"), [(5.0, True), (9.0, True), (10.0, False), (100.0, False)])
def test_a_layer_that_stiffens_and_never_breaks_is_announced_up_to_its_stiffness_at_the_largest_force(
    stiffening, is_announced
):
    tissue = Tissue(
        name="wall", rest_position_m=0.02, stiffness_n_per_m=300.0, breach_force_n=1e6, stiffening_per_m=stiffening
    )
    never = lambda true: [each._replace(breach_force_n=math.inf) for each in true]  # noqa: E731
    link = link_with(lambda: Telling(Scene((tissue,)), never), "perfect")
    link.run(3 * SECOND)
    assert (link.master.report()["ticks_on_model"] > 1000) is is_announced
    assert (account(link)["left_out"] > 0) is not is_announced
    if not is_announced:
        assert "stiffens and does not break" in account(link)["fault"]
    assert link.slave.contexts[0].report()["exceed_jnd_fraction"] == 0.0


def test_a_breach_that_only_the_master_saw_is_corrected_within_a_round_trip():
    hand = Still(0.0)
    link = link_with(paper, operator=hand)
    breach_m = 0.02 + find_scene("paper:1").tissues[0].breach_depth_m
    link.run(SECOND)
    hand.place_m = breach_m - 2e-4
    link.run(SECOND)
    # The one position beyond the breach is lost on its way.
    link.forward.cut = True
    hand.place_m = breach_m + 2e-4
    link.run(1000)
    link.forward.cut = False
    hand.place_m = breach_m - 2e-4
    link.run(20_000)
    assert link.master.held_n == (0.0,), "the master's model has breached"
    link.run(2 * DELAY_US)
    (true_n,) = link.slave.contexts[0].newest[2]
    assert true_n > 1.0
    assert link.master.held_n == pytest.approx((true_n,), rel=1e-5)


def test_the_scene_of_the_document_is_felt_without_delay():
    page = Path(__file__).parents[2] / "docs" / "understand" / "delay.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    names = {}
    exec(code, names)  # noqa: S102 - our own page
    hand = Still(0.0)
    link = link_with(lambda: as_touchable(names["Wall"]()), operator=hand)
    link.run(SECOND)
    hand.place_m = 0.032
    link.run(1000)
    assert link.master.held_n == (pytest.approx(1.6, rel=1e-5),)


def test_a_layer_that_appears_is_announced_before_it_is_touched():
    walls = [LayerAhead(0.02, 500.0)]

    class Moving:
        name, axes, breaches = "moving", 1, 0

        def step(self, sample):
            return ForceSample(sample.t_us, (sum(500.0 * max(0.0, sample.position_m[0] - w.surface_m) for w in walls),))

        def ahead(self):
            return list(walls)

    hand = Still(0.0)
    link = link_with(Moving, operator=hand)
    link.run(SECOND)
    walls[:] = [LayerAhead(0.01, 500.0)]
    link.run(300_000)
    hand.place_m = 0.012
    link.run(1000)
    assert link.master.held_n == (pytest.approx(1.0, rel=1e-5),), "at once, with a delay of 50 ms"


def test_nothing_is_believed_for_longer_than_the_hold_when_the_slave_falls_silent():
    hand = Still(0.022)
    link = link_with(paper, operator=hand)
    link.run(SECOND)
    assert link.master.held_n[0] > 0.3
    link.feedback.cut = True
    link.run(50_000 + 320_000)
    hand.place_m = 0.025
    link.run(2000)
    assert link.master.held_n == (0.0,)


def test_a_change_of_codec_and_a_new_session_begin_with_a_new_model():
    hand = Still(0.022)
    link = link_with(paper, operator=hand)
    link.run(SECOND)
    before = link.master.held_n
    link.master.change(codec="adaptive-predictive")
    for _ in range(400):
        link.run(1000)
        assert link.master.held_n == before, "the hand rests, so nothing may change"
    assert link.master.connections == 2
    assert link.master.on_model
    assert link.slave.contexts[-1].report()["continues"] is not None


def test_the_limits_of_the_device_hold_for_a_model_too():
    class Pressed:
        def __init__(self):
            self.asked_n = []

        def apply(self, force_n, _now_us):
            self.asked_n.append(force_n)

    pressed, hand = Pressed(), Still(0.0)
    wall = Telling(paper(), lambda _: (LayerAhead(0.02, 9e3),))
    link = link_with(lambda: wall, "delay=70ms", operator=hand)
    device = UserActuator(pressed, "the device")
    link.master = MasterNode(hand, device, MasterSettings(announced=True), np.random.default_rng(2))
    link.run(SECOND)
    hand.place_m = 0.03
    link.run(120_000)
    assert link.master.held_n[0] == pytest.approx(90.0, rel=1e-5)
    assert max(pressed.asked_n) == 5.0
    assert max(np.diff(pressed.asked_n)) <= 50.0 * 1e-3 + 1e-9


def test_announced_sessions_can_be_sealed(loopback):
    link = loopback(settings=MasterSettings(announced=True), sealed=True, forward="delay=20ms")
    link.run(3 * SECOND)
    assert link.master.session.sealed
    assert link.master.report()["ticks_on_model"] > 2000


def test_a_model_is_repeated_only_until_it_has_arrived():
    link = link_with(paper, "delay=50ms,loss=10%", operator=Still(0.0))
    link.run(8 * SECOND)
    assert max(link.feedback.forces_us) < 3 * SECOND, "keepalives are enough"
    assert link.master.session.received.by_kind[Kind.KEEPALIVE] > 100


def test_friction_is_the_same_at_both_ends_after_loss():
    """The master's model went through positions that the slave missed; at rest, nothing else would show that."""
    layer = Tissue(
        name="sheath", rest_position_m=0.01, stiffness_n_per_m=800.0, breach_force_n=1.0, shaft_friction_n=0.4
    )
    reach = Still(0.0)
    link = link_with(lambda: Scene((layer,)), "delay=10ms", operator=reach)
    link.run(SECOND // 5)
    for place_m in np.linspace(0.0, 0.02, 100).tolist():
        reach.place_m = place_m
        link.run(1_000)
    link.run(SECOND // 5)
    assert link.master.held_n[0] == pytest.approx(0.4, abs=0.01)
    link.forward.cut = True
    for place_m in (0.024, 0.02):  # there and back again
        reach.place_m = place_m
        link.run(2_000)
    link.forward.cut = False
    assert link.master.on_model
    assert link.master.held_n[0] < -0.3
    link.run(SECOND // 5)
    assert link.slave.contexts[0].scene.force_n == pytest.approx(0.4, abs=0.01)
    assert link.master.held_n[0] == pytest.approx(0.4, abs=0.01)
    assert link.master.on_model
