"""Positions that are only sent when they matter: one JND over both directions, end to end, in virtual time."""

import math

import numpy as np
import pytest

from hapticnet.channel.spec import parse_channel
from hapticnet.codec.positions import PromisedLine
from hapticnet.errors import SampleError, SettingsError
from hapticnet.node.positions import DeadReckoning
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import MasterState
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.base import UserScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.scene.sources import paper_scene
from hapticnet.stiffness_bound import StiffnessBound
from hapticnet.vectors import single
from tests.conftest import linked
from tests.peers import KEY

SECOND = 1_000_000
HANDS = {
    "the paper's": {},
    "thrusts of 200 mm/s and more": {"approach_s": 0.1, "push_s": 0.3, "withdraw_s": 0.3, "insertions": 2},
    "slow palpation": {"push_s": 6.0, "push_steps": 8, "withdraw_s": 1.5},
    "a trembling hand": {"tremor_rms_m": 2e-4},
}
CODECS = ("raw", "deadband", "linear-predictive", "adaptive-predictive")
SPRING = (Tissue(name="spring", rest_position_m=0.02, stiffness_n_per_m=400.0, breach_force_n=4.0),)


PAPER = paper_scene(1).tissues


def scripted(tissues=PAPER, hand=None, **settings):
    """Return both nodes and the duration of the hand's script [µs]."""
    operator = ScriptedOperator(InsertionSettings(**({"insertions": 1} | (hand or {}))), np.random.default_rng(1))
    return line_link(operator, tissues, **settings), operator.duration_us


def line_link(operator, scene, *args, **settings):
    """Return both nodes; positions are promised lines unless told otherwise."""
    make_scene = scene if callable(scene) else lambda _: Scene(scene)
    return linked(operator, make_scene, *args, **({"positions": "line", "record": True} | settings))


def cut(loop, *ways):
    """Let nothing arrive any more, on one way or on both."""
    for way in ways or ("forward", "feedback"):
        getattr(loop, way).change(parse_channel("loss=100%"))


def felt_and_true(loop, scene):
    """Return, for each tick, what its answer left applied, and the true force of the true position [N]."""
    table = loop.master.recording.table()
    touched = Scene(scene)
    true_n = [
        touched.step(PositionSample(int(t_us), single((tip_m,)))).force_n[0]
        for t_us, tip_m in zip(table["t_us"].tolist(), table["position_m"].tolist(), strict=True)
    ]
    # What arrives in answer to a tick drives the device in the next one.
    return table["held_n"][1:], np.array(true_n[:-1])


def exceeding(felt_n, true_n, law):
    return (np.abs(felt_n - true_n) > law.thresholds_n(np.abs(felt_n)) * (1.0 + 1e-9)).sum()


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("hand", HANDS)
def test_the_felt_force_is_within_one_jnd_of_the_true_force_of_the_true_position(codec, hand):
    loop, duration_us = scripted(hand=HANDS[hand], codec=codec)
    loop.run(duration_us)
    felt_n, true_n = felt_and_true(loop, PAPER)
    assert true_n.max() > 3.0
    assert exceeding(felt_n, true_n, WeberLaw()) == 0
    positions = loop.master.report()["positions"]
    assert positions["sent"] < (0.075 if codec == "raw" else 0.045) * positions["ticks"]
    assert loop.slave.report()["sessions"][0]["breaches"] == (6 if "200" in hand else 3)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
@pytest.mark.parametrize("law", [WeberLaw(multiplier=4.0), WeberLaw(weber_fraction=0.0), WeberLaw(weber_fraction=0.3)])
def test_it_holds_for_every_share_and_law(share, law):
    loop, duration_us = scripted(codec="deadband", position_share=share, law=law)
    loop.run(duration_us)
    felt_n, true_n = felt_and_true(loop, PAPER)
    assert exceeding(felt_n, true_n, law) == 0


def test_raw_positions_are_the_default_and_what_a_scene_gets_that_says_nothing_of_its_force():
    class Spring:
        axes, name = 1, "spring"

        def step(self, sample):
            return ForceSample(sample.t_us, (max(0.0, 300.0 * (sample.position_m[0] - 0.02)),))

    for loop, _ in (scripted(positions="raw"), scripted(lambda _: Spring())):
        loop.run(SECOND)
        positions = loop.master.report()["positions"]
        assert positions["sent"] == positions["ticks"]
        assert loop.slave.report()["sessions"][0]["position_share"] == 0.0
    assert MasterSettings().positions == "raw"


@pytest.mark.parametrize("sealed", [False, True])
def test_a_link_with_delay_jitter_and_loss_stays_up_and_ends_at_the_same_scene(sealed):
    network = "delay=20ms,jitter=normal:3ms,loss=5%"
    loop, duration_us = scripted(forward=network, codec="adaptive-predictive", key=KEY if sealed else None)
    states = []
    for _ in range(duration_us // 10_000):
        loop.run(10_000)
        states.append(loop.master.session.state)
    begun = states.index(MasterState.ESTABLISHED)
    assert set(states[begun:]) == {MasterState.ESTABLISHED}
    every, _ = scripted(forward=network, codec="adaptive-predictive", positions="raw")
    every.run(duration_us)
    errors_n = [np.subtract(*felt_and_true(each, PAPER)) for each in (loop, every)]
    sparse_n, raw_n = (float(np.sqrt(np.mean(error_n**2))) for error_n in errors_n)
    assert sparse_n < 1.1 * raw_n
    session = loop.slave.report()["sessions"][0]
    assert session["breaches"] == 3
    assert session["received"]["by_kind"]["position"] < 0.25 * duration_us / 1000


def test_a_slave_that_hears_no_more_falls_silent_and_the_force_is_let_go():
    loop, _ = scripted(hand={"push_steps": 1, "depth_m": 0.025, "pause_s": 5.0}, codec="deadband")
    loop.run(4 * SECOND)
    assert loop.master.held_n[0] > 0.5
    cut(loop, "forward")
    steps = loop.slave.report()["sessions"][0]["between"]
    loop.run(400_000)
    assert loop.slave.report()["sessions"][0]["between"] - steps <= 150
    loop.run(100_000)
    assert loop.master.session.state is MasterState.STALE
    assert loop.master.held_n == (0.0,)
    loop.forward.change(parse_channel("perfect"))
    loop.run(300_000)
    assert loop.master.session.state is MasterState.ESTABLISHED
    assert loop.master.held_n[0] > 0.5


class Wall:
    """A scene of a user's: a spring on three axes that says how stiff it is."""

    axes, name = 3, "wall"

    def __init__(self, bound=lambda wall: StiffnessBound(400.0 if wall.x > 0.02 else 0.0, 0.0, *wall.box())):
        self.x = 0.0
        self.asked = bound
        self.stepped = []

    def box(self):
        return ((0.02, -1.0, -1.0), (1.0, 1.0, 1.0)) if self.x > 0.02 else ((-1.0, -1.0, -1.0), (0.02, 1.0, 1.0))

    def step(self, sample):
        self.x = sample.position_m[0]
        self.stepped.append(sample)
        return ForceSample(sample.t_us, (max(0.0, 400.0 * (self.x - 0.02)), 0.0, 0.0))

    def stiffness_bound(self):
        return self.asked(self)


class Circling:
    """A hand on three axes."""

    axes, duration_us = 3, 2 * SECOND

    def sample(self, t_us):
        angle = 2.0 * np.pi * t_us / 1e6
        return PositionSample(t_us, (0.02 + 0.008 * np.sin(angle), 0.01 * np.cos(angle), 0.003 * np.sin(3.0 * angle)))


def with_wall(wall, **settings):
    return line_link(Circling(), lambda _: UserScene(wall), **settings)


@pytest.mark.parametrize("codec", CODECS)
def test_a_scene_of_a_user_on_three_axes_that_says_how_stiff_it_is_is_felt_within_one_jnd(codec):
    wall = Wall()
    loop = with_wall(wall, codec=codec)
    loop.run(2 * SECOND)
    table = loop.master.recording.table()
    x = np.array([single((each,))[0] for each in table["position_x_m"].tolist()])
    felt_n = np.stack([table[f"received_{axis}_n"] for axis in "xyz"], axis=1)[1:]
    true_n = np.maximum(0.0, 400.0 * (x - 0.02))[:-1, np.newaxis] * [1.0, 0.0, 0.0]
    error_n, size_n = (np.linalg.norm(each, axis=1) for each in (felt_n - true_n, felt_n))
    assert true_n.max() > 3.0
    assert (error_n <= WeberLaw().thresholds_n(size_n) * (1.0 + 1e-9)).all()
    assert loop.master.report()["positions"]["sent"] < 500
    times_us = [sample.t_us for sample in wall.stepped]
    assert times_us == sorted(times_us)


def test_a_scene_that_cannot_tell_gets_every_position_and_no_other():
    wall = Wall(bound=lambda _: None)
    loop = with_wall(wall)
    loop.run(SECOND // 2)
    positions = loop.master.report()["positions"]
    assert positions["sent"] == positions["ticks"] == len(wall.stepped)
    assert loop.slave.report()["sessions"][0]["between"] == 0


def failing(_):
    raise ValueError("the sensor is gone")


@pytest.mark.parametrize("bound", [failing, lambda _: "stiff", lambda _: (1.0, 0.0, (0.0,), (1.0,)), lambda _: 7])
def test_an_bound_that_fails_or_is_none_ends_its_session_in_words(bound):
    loop = with_wall(Wall(bound=bound))
    loop.run(SECOND // 2)
    (session,) = loop.slave.report()["sessions"]
    assert "the scene failed" in session["end_reason"]
    assert "the scene failed" in loop.master.end_reason


def test_an_bound_that_was_lost_is_told_again_and_meanwhile_positions_go_on():
    loop, duration_us = scripted(codec="adaptive-predictive", hand={"push_s": 6.0})
    loop.run(SECOND)
    cut(loop, "feedback")
    before = loop.master.report()["positions"]["sent"]
    loop.run(150_000)  # less than it takes to go stale; the surface is met in this time or later
    loop.feedback.change(parse_channel("perfect"))
    loop.run(duration_us - SECOND - 150_000)
    positions = loop.master.report()["positions"]
    assert positions["sent"] - before < 0.1 * positions["ticks"]
    assert positions["reasons"]["left"] == 9
    assert loop.slave.report()["sessions"][0]["breaches"] == 3


def test_keepalives_are_few_and_fewest_while_nothing_is_felt():
    rest = {"approach_m": 0.010, "depth_m": 0.010, "push_s": 8.0, "push_steps": 1}
    pressing = {"depth_m": 0.022, "push_s": 0.5, "push_steps": 1, "pause_s": 8.0}
    rates = []
    for hand in (rest, pressing):
        loop, _ = scripted(hand=hand, codec="deadband")
        loop.run(2 * SECOND)
        start = loop.master.session.received.by_kind[6]
        loop.run(4 * SECOND)
        rates.append((loop.master.session.received.by_kind[6] - start) / 4.0)
        assert loop.master.session.state is MasterState.ESTABLISHED
        kinds = {type(event).__name__ for event in iter(loop.master.next_event, None)}
        assert "LinkStale" not in kinds
    assert rates[0] < 3.0 < rates[1] < 12.0


def test_a_dead_link_is_noticed_though_nothing_is_felt():
    loop, _ = scripted(hand={"approach_m": 0.010, "depth_m": 0.010, "push_s": 8.0, "push_steps": 1})
    loop.run(2 * SECOND)
    cut(loop, "feedback")
    loop.run(1_500_000)
    assert loop.master.session.state is MasterState.STALE


def test_a_forged_time_rules_for_one_position_only():
    reckoning = DeadReckoning(1000)
    everywhere = StiffnessBound(0.0, 0.0, (-1.0,), (1.0,))
    for now_us, t_us in ((1_005_000, 1_000_000), (1_006_000, 900_000_000), (1_007_000, 1_002_000)):
        reckoning.receive(PromisedLine(t_us, (0.0,), (0.1,), (0.0,)), now_us)
        reckoning.news(everywhere, (0.0,), first=True)
        assert reckoning.present_us(now_us) == t_us
        reckoning.answered(t_us)
        assert reckoning.next_step_us() == now_us + 1000
    reckoning.receive(PromisedLine(1_010_000, (0.0,), (0.1,), (0.0,)), 1_025_000)
    assert reckoning.present_us(1_025_000) == 1_019_000, "it came 10 ms late, of which 1 % of 18 ms are forgotten"
    assert reckoning.at(1_019_000)[0] == pytest.approx(0.0009, rel=1e-3)


def test_a_scene_that_refuses_places_on_the_line_is_asked_once_a_period():
    class Picky:
        axes, name, asked, tip_m = 1, "picky", 0, 0.0

        def stiffness_bound(self):
            return StiffnessBound(0.0, 0.0, (-1.0,), (1.0,))

        def step(self, sample):
            self.asked += 1
            if self.asked > 5:
                raise SampleError("not there")
            return ForceSample(sample.t_us, (0.0,))

    scene = Picky()
    loop, _ = scripted(lambda _: scene)
    loop.run(SECOND // 5)
    assert 5 < scene.asked < 300
    assert not loop.master.finished


def test_a_largest_age_that_leaves_no_answer_fresh_is_refused():
    limits = SessionSettings(max_age_us=150_000)
    assert MasterSettings(session=limits).session is limits
    with pytest.raises(SettingsError, match=r"at least 0\.2 s"):
        MasterSettings(session=limits, positions="line")
    loop, _ = scripted(session=SessionSettings(max_age_us=200_000), forward="delay=5ms")
    loop.run(SECOND)
    assert loop.master.session.state is MasterState.ESTABLISHED
    assert loop.master.session.received.too_old == 0


@pytest.mark.parametrize("dies", ["both", "feedback", "forward"])
@pytest.mark.parametrize("multiplier", [1.0, 40.0])
@pytest.mark.parametrize("codec", ["deadband", "linear-predictive", "motion-predictive"])
def test_a_dead_link_holds_no_force_longer_whatever_the_jnd(codec, multiplier, dies):
    loop, _ = scripted(
        hand={"push_steps": 1, "depth_m": 0.0255, "pause_s": 5.0}, codec=codec, law=WeberLaw(multiplier=multiplier)
    )
    loop.run(4 * SECOND)
    assert loop.master.held_n[0] > 0.7
    cut(loop, *(("forward", "feedback") if dies == "both" else (dies,)))
    # Of a line the slave makes answers for up to 150 ms.
    loop.run(301_000 + (150_000 if dies == "forward" else 0))
    assert loop.master.held_n[0] == 0.0
    assert loop.master.session.state is MasterState.STALE


class PressAndStay:
    """A hand that presses and goes back to where a spring of 400 N/m has a small force, or a large JND holds one."""

    axes, duration_us = 1, 5 * SECOND

    def __init__(self, stays_n):
        self.stays_m = stays_n / 400.0

    def sample(self, t_us):
        pressed_m = 0.005 * np.sin(np.pi * t_us / 1e6) if t_us < SECOND else 0.0
        return PositionSample(t_us, (0.02 + max(self.stays_m, pressed_m),))


@pytest.mark.parametrize("multiplier", [0.5, 1.0, 4.0, 40.0])
def test_what_stays_longer_than_that_is_too_little_to_press(multiplier):
    longer = []
    for stays_n in (-0.1, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.1):
        law = WeberLaw(multiplier=multiplier)
        loop = line_link(PressAndStay(stays_n), SPRING, law=law)
        master = loop.master
        loop.run(2 * SECOND)
        held_n = master.held_n[0]
        cut(loop)
        loop.run(301_000)
        if master.held_n[0]:
            longer.append(master.held_n[0])
            assert master.held_n[0] == held_n < min(2.0 * law.threshold_n(0.0), 0.05)
        loop.run(700_000)
        assert master.held_n[0] == 0.0
    assert bool(longer) == (multiplier < 40.0), "what is held at a large JND is large"


class PressAgain:
    """A hand that presses, waits outside for 0.7 s, and presses again."""

    axes, duration_us = 1, 3_000_000

    def sample(self, t_us):
        presses = 400_000 <= t_us < 900_000 or t_us >= 1_600_000
        depth_m = 0.004 * np.sin(np.pi * ((t_us - 400_000) % 1_200_000) / 500_000) if presses else 0.0
        return PositionSample(t_us, (max(0.0, 0.019 + depth_m),))


@pytest.mark.parametrize("codec", ["deadband", "motion-predictive"])
@pytest.mark.parametrize("announced", [False, True])
def test_a_link_that_is_cut_while_nothing_is_felt_lets_go_of_what_the_position_would_make(codec, announced):
    loop = line_link(PressAgain(), SPRING, codec=codec, announced=announced)
    loop.run(1_300_000)
    cut(loop)
    loop.run(1_700_000)
    table = loop.master.recording.table()
    assert table["held_n"][:1200].max() > 1.0
    assert table["held_n"][table["t_us"] > 1_700_000].max() < WeberLaw().floor_n


TICK_US = 1_000


class Vibrating:
    """A hand that vibrates with 2 mm at 150 Hz, around a place that wanders by 10 mm."""

    axes = 1

    def __init__(self, centre_m):
        self._centre_m = centre_m

    def sample(self, t_us):
        t_s = 1e-6 * t_us
        wander_m = 0.01 * math.sin(2.0 * math.pi * 0.7 * t_s)
        return PositionSample(t_us, (self._centre_m + wander_m + 0.002 * math.sin(2.0 * math.pi * 150.0 * t_s),))


class Wandering:
    """A hand that is pushed about at random, and drawn to a place."""

    axes = 1

    def __init__(self, centre_m):
        self._centre_m, self._rng = centre_m, np.random.default_rng(1)
        self._x_m, self._v_m_per_s = centre_m - 0.005, 0.0

    def sample(self, t_us):
        drawn = 0.02 * self._v_m_per_s + 0.05 * (self._x_m - self._centre_m)
        self._v_m_per_s += float(self._rng.normal(0.0, 0.02)) - drawn
        self._x_m += 1e-3 * self._v_m_per_s
        return PositionSample(t_us, (self._x_m,))


def layers(**properties):
    return tuple(
        Tissue(name=f"at {rest_m}", rest_position_m=rest_m, stiffness_n_per_m=n_per_m, breach_force_n=3.0, **properties)
        for rest_m, n_per_m in ((0.02, 800.0), (0.026, 500.0))
    )


LAYERS = {
    "elastic": layers(),
    "friction": layers(shaft_friction_n=0.3),
    "viscous": layers(viscosity_n_s_per_m=4.0),
    "viscous and stiffening": layers(viscosity_n_s_per_m=4.0, stiffening_per_m=100.0),
    "recovering": layers(recovery_time_s=0.3),
}


def applied_n(master, t_us):
    """Return the force that the master's decoder gives now at the position of the newest tick [N]."""
    return master._applied._stream.decoder.reconstruct(t_us, master.position_m, t_us)[0]


def wrong_and_ticks(layers, hand, law, **settings):
    """Return at how many ticks the answer leaves a force that is no JND near the true one, and of how many."""
    loop, touched, ticks, wrong = line_link(hand, layers, law=law, **settings), Scene(layers), 0, 0
    loop.run(TICK_US)
    for _ in range(1200):
        loop.run(TICK_US)
        t_us, at_m = loop.now_us - TICK_US, single(loop.master.position_m)
        true_n = touched.step(PositionSample(t_us, at_m)).force_n[0]
        felt_n = applied_n(loop.master, t_us)
        ticks += true_n > 0.1
        wrong += abs(felt_n - true_n) > law.threshold_n(abs(felt_n)) * (1.0 + 1e-6)
    assert touched.breaches == loop.slave.contexts[0].scene.breaches
    return wrong, ticks


@pytest.mark.parametrize("codec", [*CODECS, "motion-predictive"])
@pytest.mark.parametrize("scene", LAYERS)
@pytest.mark.parametrize("hand", [Vibrating, Wandering])
def test_it_holds_for_hands_and_layers_that_find_the_gaps(hand, scene, codec):
    wrong, ticks = wrong_and_ticks(
        LAYERS[scene], hand(0.024), WeberLaw(multiplier=2.0), codec=codec, position_share=0.9
    )
    assert ticks > 50
    assert wrong == 0


@pytest.mark.parametrize("scene", LAYERS)
def test_it_holds_with_announced_contact(scene):
    wrong, ticks = wrong_and_ticks(LAYERS[scene], Vibrating(0.024), WeberLaw(), codec="deadband", announced=True)
    assert ticks > 50
    assert wrong == 0
