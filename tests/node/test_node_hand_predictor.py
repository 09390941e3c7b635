"""Forces for where the hand will be: the prediction, the copies of scenes, and the sessions that use them."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapticnet as hn
from hapticnet.codec.positions import PromisedLine
from hapticnet.node.hand_predictor import (
    FASTEST,
    LARGEST_SPEED_M_PER_S,
    LONGEST_AHEAD_US,
    LONGEST_GAP,
    STEPS_PER_POSITION,
    ForceAhead,
    HandPredictor,
)
from hapticnet.protocol.stats import MEDIAN_OF, RoundTrip
from hapticnet.protocol.wire import MODULUS, wrap
from hapticnet.samples import PositionSample
from hapticnet.scene.base import UserScene
from hapticnet.scene.settings import SceneSettings, Tissue
from hapticnet.scene.sources import find_scene, make_scene

AHEAD_US = 50_000
TISSUE = Tissue(name="soft", rest_position_m=0.01, stiffness_n_per_m=400.0, breach_force_n=2.0)
SCENES = {
    "paper": find_scene("paper:3"),
    "recovering": SceneSettings(
        name="recovering",
        tissues=(
            replace(TISSUE, recovery_time_s=0.3, shaft_friction_n=0.4, viscosity_n_s_per_m=5.0),
            replace(TISSUE, name="stiff", rest_position_m=0.013, stiffening_per_m=150.0),
        ),
    ),
    "phantom": find_scene("phantom"),
}


def predictor(path, *, seconds=4.0, ahead_us=AHEAD_US, axes=1):
    """Return a predictor that has seen a path, and its errors [m] over the last second."""
    hand, errors, pending = HandPredictor(axes, 1000), [], {}
    for t_us in range(0, round(seconds * 1e6), 1000):
        hand.receive(t_us, path(1e-6 * t_us))
        pending[t_us + ahead_us] = hand.predict(ahead_us)
        if t_us >= 1e6 * (seconds - 1.0):
            errors.append(math.dist(pending[t_us], path(1e-6 * t_us)))
    return hand, errors


def test_a_hand_at_rest_is_predicted_to_stay():
    _, errors = predictor(lambda _: (0.012, -0.03), axes=2)
    assert max(errors) == 0.0


def test_a_movement_that_repeats_is_learned():
    def path(t_s):
        return (0.02 * math.sin(2.0 * math.pi * t_s), 0.01 * math.cos(2.0 * math.pi * t_s))

    hand, errors = predictor(path, axes=2)
    unlearned = HandPredictor(2, 1000)
    unlearned.receive(3_998_000, path(3.998))
    unlearned.receive(3_999_000, path(3.999))
    assert max(errors) < 1e-4 < math.dist(unlearned.predict(AHEAD_US), hand.predict(AHEAD_US))


def test_missing_positions_change_little():
    rng = np.random.default_rng(1)
    hand, complete = HandPredictor(1, 1000), HandPredictor(1, 1000)
    for t_us in range(0, 2_000_000, 1000):
        at_m = (0.02 * math.sin(6e-6 * t_us),)
        complete.receive(t_us, at_m)
        complete.predict(AHEAD_US)
        if rng.random() > 0.1 or t_us == 1_999_000:
            hand.receive(t_us, at_m)
            hand.predict(AHEAD_US)
    assert hand.predict(AHEAD_US)[0] == pytest.approx(complete.predict(AHEAD_US)[0], abs=2e-4)


def test_after_a_gap_or_a_clock_that_went_back_the_movement_is_looked_at_afresh():
    for later_us in (3_000_000, 0):
        hand, _ = predictor(lambda t_s: (0.05 * t_s,), seconds=2.0)
        hand.receive(later_us, (0.3,))
        assert hand.predict(AHEAD_US) == (0.3,)


def test_a_leap_is_not_carried_on():
    hand, _ = predictor(lambda t_s: (0.01 * math.sin(9.0 * t_s),))
    before_m = hand.predict(AHEAD_US)[0]
    hand.receive(4_000_000, (0.5,))
    assert abs(hand.predict(AHEAD_US)[0] - 0.5) <= 1e-6 * AHEAD_US * LARGEST_SPEED_M_PER_S + 1e-12
    for t_us in range(4_001_000, 4_200_000, 1000):
        hand.receive(t_us, (0.5,))
    assert hand.predict(AHEAD_US)[0] == pytest.approx(0.5, abs=1e-3)
    assert abs(before_m) < 0.02


def test_one_wrong_position_is_not_carried_on():
    hand, _ = predictor(lambda t_s: (0.005 * math.sin(6.0 * t_s),))
    for t_us in range(4_000_000, 4_050_000, 1000):
        at_m = 0.005 * math.sin(6e-6 * t_us)
        hand.receive(t_us, (at_m + 0.005 * (t_us == 4_010_000),))
        assert hand.predict(AHEAD_US)[0] == pytest.approx(at_m, abs=0.0051)


def test_no_leaps_make_equations_that_cannot_be_solved():
    for seed in range(30):
        rng, at_m = np.random.default_rng(seed), 0.0
        hand = HandPredictor(1, 1000)
        for t_us in range(0, 700_000, 1000):
            if rng.random() < 0.01:
                at_m = rng.choice([1e15, -1e15, 0.0, 1e10, rng.uniform(-1.0, 1.0)])
            hand.receive(t_us, (at_m,))
            assert hand.predict(LONGEST_AHEAD_US) == pytest.approx((at_m,), abs=0.16)


@pytest.mark.parametrize("period_us", [100, 500, 667, 1000, 10_000])
def test_the_rate_of_positions_changes_little(period_us):
    hand = HandPredictor(1, period_us)
    for t_us in range(0, 3_000_000, period_us):
        hand.receive(t_us, (0.02 * math.sin(6e-6 * t_us),))
        predicted = hand.predict(AHEAD_US)[0]
    assert predicted == pytest.approx(0.02 * math.sin(6e-6 * (t_us + AHEAD_US)), abs=3e-4)


@pytest.mark.plain
def test_a_clock_that_runs_away_makes_no_more_work_than_it_pays_for():
    hand, made = HandPredictor(1, 1000), []
    push = hand._push
    hand._push = lambda position_m: (made.append(1), push(position_m))
    for count in range(1000):
        hand.receive(200_000 * count, (0.0,))
    assert len(made) <= 1000 * (STEPS_PER_POSITION + 1) + LONGEST_GAP


@given(
    st.lists(st.tuples(st.integers(1, 300), st.floats(-1e6, 1e6)), min_size=2, max_size=60),
    st.integers(1_000, LONGEST_AHEAD_US),
)
def test_no_hand_is_predicted_faster_than_the_limit(moves, ahead_us):
    hand, t_us, largest_m = HandPredictor(1, 1000), 0, max(abs(at_m) for _, at_m in moves)
    for ticks, at_m in moves:
        t_us += 1000 * ticks
        hand.receive(t_us, (at_m,))
        predicted = hand.predict(ahead_us)[0]
        assert abs(predicted - at_m) <= 1e-6 * ahead_us * LARGEST_SPEED_M_PER_S + 1e-9 * largest_m + 1e-12


def test_a_sudden_stop_is_predicted_no_faster_than_twice_as_before():
    hand, _ = predictor(lambda t_s: (0.1 * t_s,))
    for t_us in range(4_000_000, 4_030_000, 1000):
        hand.receive(t_us, (0.4,))
        assert abs(hand.predict(AHEAD_US)[0] - 0.4) <= FASTEST * 0.1 * 1e-6 * AHEAD_US + 1e-9


def test_promised_lines_are_joined_by_a_smooth_path():
    def place(t_s):
        return 0.02 * math.sin(6.0 * t_s)

    hand, dense, line, errors = HandPredictor(1, 1000), HandPredictor(1, 1000), None, []
    for t_us in range(0, 4_000_000, 1000):
        t_s = 1e-6 * t_us
        dense.receive(t_us, (place(t_s),))
        if t_us % 40_000 == 0:
            line = PromisedLine(t_us, (place(t_s),), (0.12 * math.cos(6.0 * t_s),), (0.0,))
            hand.follow(line)
        hand.receive(t_us, line.at(t_us))
        if t_us >= 3_000_000 and t_us % 40_000 == 0:
            errors.append(abs(hand.predict(AHEAD_US)[0] - place(t_s + 0.05)))
        else:
            hand.predict(AHEAD_US)
        dense.predict(AHEAD_US)
    assert max(errors) < 1e-3


@pytest.mark.parametrize("settings", SCENES.values(), ids=SCENES)
@given(st.lists(st.floats(-0.01, 0.06), min_size=1, max_size=40), st.integers(0, 39), st.lists(st.floats(-0.01, 0.06)))
def test_a_copy_goes_on_like_its_scene_and_leaves_it_alone(settings, way, when, elsewhere):
    scene, alone = make_scene(settings), make_scene(settings)
    samples = [PositionSample(1000 * k, (at, *(0.3 * at,) * (scene.axes - 1))) for k, at in enumerate(way)]
    forces, ahead = [], None
    for k, sample in enumerate(samples):
        if k == when:
            twin = scene.copy()
            ahead = [twin.step(each).force_n for each in samples[k:]]
        stray = scene.copy()
        for more, at in enumerate(elsewhere):
            stray.step(PositionSample(sample.t_us + 1000 * more, (at,) * scene.axes))
        forces.append(scene.step(sample).force_n)
    assert forces == [alone.step(each).force_n for each in samples]
    assert ahead is None or ahead == forces[when:]


def test_round_trips_are_those_of_answers_that_a_position_names():
    trip = RoundTrip()
    for k in range(MEDIAN_OF):
        trip.sent(wrap(MODULUS - 3 + k), 10_000 * k)
        trip.named(wrap(MODULUS - 3 + k), 10_000 * k + (4_000 if k % 3 else 9_000))
    assert trip.us == 4_000  # the median, over a wrap of the numbers
    trip.sent(100, 1_000_000)
    trip.named(99, 1_001_000)  # an earlier one
    trip.named(101, 1_500_000)  # a later one: 100 was lost
    trip.sent(102, 2_000_000)
    trip.named(102, 1_000_000)  # the clock went back
    assert trip.us == 4_000
    for k in range(5):
        trip.sent(200 + k, 3_000_000 + 10_000 * k)
        trip.named(200 + k, 3_008_000 + 10_000 * k)
    assert trip.us == 8_000  # a round trip that doubles counts after half of those that are remembered


def linked(*, delay_ms=0, seconds=6.0, **arguments):
    channel = f"delay={delay_ms}ms" if delay_ms else "perfect"
    link = hn.virtual_link(forward=channel, feedback=channel, **{"scene": "paper:1", "codec": "deadband"} | arguments)
    link.run(seconds=seconds)
    return link


@pytest.mark.parametrize("positions", ["raw", "line"])
@pytest.mark.parametrize("codec", ["deadband", "motion-predictive"])
def test_without_delay_nothing_changes(codec, positions):
    plain, predicted = (linked(codec=codec, positions=positions, predicted=each) for each in (False, True))
    assert predicted.report().slave["predicted"] == {"answers": 0, "ahead_us": 0, "fault": None}
    for samples in ("slave_samples", "master_samples"):
        one, other = getattr(plain, samples)(), getattr(predicted, samples)()
        assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in one)
    sizes = [each.report().slave["sent"]["by_kind"] for each in (plain, predicted)]
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize(("scene", "codec", "positions", "gain"), [
    ("paper:1", "raw", "raw", 4.0),
    ("paper:1", "motion-predictive", "raw", 8.0),
    ("paper:1", "motion-predictive", "line", 3.0),
    ("phantom", "deadband", "raw", 1.5),
])  # fmt: skip
def test_over_a_delay_less_of_the_force_is_wrong_and_nothing_more_breaks(scene, codec, positions, gain):
    arguments = {"scene": scene, "codec": codec, "positions": positions, "delay_ms": 25}
    plain, predicted = (linked(**arguments, predicted=each).report() for each in (False, True))
    assert predicted.slave["predicted"]["ahead_us"] == pytest.approx(50_000, abs=1_000)
    assert predicted.felt_exceed_jnd_fraction * gain < plain.felt_exceed_jnd_fraction
    assert predicted.felt_rmse_n < 0.7 * plain.felt_rmse_n
    assert predicted.breaches == plain.breaches
    assert predicted.exceed_jnd_fraction == 0.0  # what is held beside what was coded


def test_a_codec_that_follows_a_hand_on_lines_stays_bounded():
    channel = "delay=60ms,jitter=normal:5ms,loss=10%"
    for seed in (4, 5):  # without the bound, 32 and 21 N
        link = hn.virtual_link(
            scene="paper:1", codec="motion-predictive", forward=channel, feedback=channel, predicted=True,
            positions="line", seed=seed,
        )  # fmt: skip
        link.run(seconds=6.0)
        assert np.abs(link.master_samples()["held_n"]).max() < 7.0


@dataclass
class Spring:
    """A user's scene, with a method ``copy`` that fails from some call on."""

    fails_after: int = 1 << 62
    steps: list[float] = field(default_factory=list)
    copies: int = 0

    def step(self, sample):
        self.steps.append(sample.position_m[0])
        return max(300.0 * (sample.position_m[0] - 0.01), 0.0)

    def copy(self):
        self.copies += 1
        if self.copies > self.fails_after:
            raise RuntimeError("no room")
        return Spring()


def test_a_scene_of_the_users_is_copied_if_it_says_how():
    spring = Spring()
    report = linked(scene=spring, delay_ms=25, predicted=True).report()
    assert report.slave["predicted"]["answers"] == spring.copies > 5_000
    assert len(spring.steps) == report.samples  # the copies were stepped, and not the scene
    assert report.felt_exceed_jnd_fraction < 0.1


def test_a_copy_that_fails_is_told_and_the_present_forces_are_served():
    report = linked(scene=Spring(fails_after=1_000), delay_ms=25, predicted=True).report()
    assert report.slave["predicted"]["answers"] == 1_000
    assert "no room" in report.slave["predicted"]["fault"]
    assert report.samples > 5_000


def test_with_a_codec_that_follows_the_hand_a_copy_that_fails_ends_the_session():
    spring = Spring(fails_after=1_000)
    link = hn.virtual_link(
        scene=spring, codec="motion-predictive", forward="delay=25ms", feedback="delay=25ms",
        predicted=True,
    )  # fmt: skip
    with pytest.raises(hn.UnavailableError, match=r"its copy failed: .*no room"):
        link.run(seconds=6.0)
    assert spring.copies == 1_001


def test_a_scene_that_cannot_be_copied_goes_without():
    class Plain:
        def step(self, sample):
            return 100.0 * max(sample.position_m[0], 0.0)

    link = linked(scene=Plain(), delay_ms=25, predicted=True)
    assert link.report().slave["predicted"] is None


def test_what_a_copy_refuses_is_answered_for_the_present():
    ahead = ForceAhead(make_scene(SCENES["paper"]), 1000)
    assert ahead.answer(PositionSample(0, (1e6,)), 0, 1_000) is None  # no delay besides the tick
    for t_us in range(1_000, 300_000, 1000):
        answer = ahead.answer(PositionSample(t_us, (1e6,)), t_us, 50_000)
        assert answer is None or math.isfinite(answer[1][0])


def test_users_scenes_keep_their_checks_in_copies():
    copied = UserScene(Spring(), "own scene").copy()
    assert isinstance(copied, UserScene)
    assert copied.step(PositionSample(0, (0.02,))).force_n == pytest.approx((3.0,))


@pytest.mark.parametrize("axes", [1, 2])
def test_a_copy_that_is_the_scene_itself_or_has_other_axes_ends_only_the_prediction(axes):
    class Own(Spring):
        def copy(self):
            other = self if axes == 1 else Spring()
            other.axes = axes
            return other

    report = linked(scene=Own(), delay_ms=25, predicted=True, seconds=1.0).report()
    assert report.slave["predicted"]["answers"] == 0
    assert "another object" in report.slave["predicted"]["fault"]
    assert report.slave["end_reason"] is None


class Robot:
    """A scene that is real: it has no copy, and says up to which force it may move ahead."""

    def __init__(self, moves_ahead_n=20.0):
        self.moves_ahead_n = moves_ahead_n

    def step(self, sample):
        return max(150.0 * (sample.position_m[0] - 0.01), 0.0)


def wrong(link):
    """Return the RMS of what is held beside the force of the robot where the hand is [N]."""
    ticks = link.master_samples()
    return float(np.sqrt(np.mean((ticks["held_n"] - np.maximum(150.0 * (ticks["position_m"] - 0.01), 0.0)) ** 2)))


def test_a_robot_that_may_moves_ahead_over_short_links():
    short, led = (linked(scene=Robot(), codec="raw", delay_ms=5, predicted=each) for each in (False, True))
    assert wrong(led) < 0.6 * wrong(short)
    long, unled = (linked(scene=Robot(), codec="raw", delay_ms=25, predicted=each) for each in (False, True))
    assert unled.report().slave["predicted"]["answers"] == 0
    assert wrong(unled) == wrong(long)


def test_past_its_force_a_robot_is_where_the_hand_is():
    free, limited = (linked(scene=Robot(limit_n), delay_ms=5, predicted=True) for limit_n in (20.0, 1.0))
    assert limited.report().slave["predicted"]["answers"] < free.report().slave["predicted"]["answers"]
    slave, master = limited.slave_samples(), limited.master_samples()
    sent_m = dict(zip(master["t_us"].tolist(), master["position_m"].astype(np.float32).tolist(), strict=True))
    pushed = np.flatnonzero(slave["force_n"] > 1.0) + 1
    moves = [(slave["t_us"][k], slave["position_m"][k]) for k in pushed[pushed < len(slave["t_us"])]]
    assert len(moves) > 500
    assert all(sent_m[t_us] == pytest.approx(at_m, abs=1e-9) for t_us, at_m in moves)


def test_a_robot_does_not_move_ahead_with_a_codec_that_follows_the_hand():
    report = linked(scene=Robot(), codec="motion-predictive", delay_ms=5, predicted=True).report()
    assert report.slave["predicted"] is None


@pytest.mark.parametrize("limit", [-1.0, math.inf, math.nan, "1 N", True])
def test_a_limit_of_a_robot_that_is_no_force_is_refused(limit):
    robot = Robot()
    robot.moves_ahead_n = limit
    with pytest.raises(hn.SettingsError, match="moves_ahead_n"):
        UserScene(robot, "own robot")
