import numpy as np
import pytest

import hapticnet as hn
from hapticnet.cli.operators import check_operator, make_operator
from hapticnet.errors import SettingsError
from hapticnet.operator import yielding
from hapticnet.operator.yielding import DEVICE_KEYS, HAND_KEYS, HANDS, YieldingOperator, parse_hand, scripted_yielding
from hapticnet.sweep.sources import touched

WALL = """
name = "wall"
[[tissue]]
name = "wall"
rest_position_m = 0.02
stiffness_n_per_m = 300.0
breach_force_n = 500.0
"""


def test_a_name_alone_is_that_hand_on_an_ideal_device():
    for name, hand in HANDS.items():
        assert parse_hand(f"hand:{name}") == (hand, yielding.GroundedSettings(), None, "")


def test_every_key_changes_its_own_value():
    keys = dict(zip([*HAND_KEYS, *DEVICE_KEYS], np.linspace(0.001, 0.01, 11).tolist(), strict=True))
    keys |= {"stiffness": 12.0, "max-force": 3.0, "rate": 500.0}
    found = parse_hand("hand: arm , " + ", ".join(f"{key} = {value}" for key, value in keys.items()))
    for key, name in HAND_KEYS.items():
        assert getattr(found.hand, name) == keys[key]
    for key, name in DEVICE_KEYS.items():
        assert getattr(found.device, name) == keys[key]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hand", "unknown hand ''; there are: arm, stiff-arm"),
        ("hand:am", r"unknown hand 'am' \(did you mean 'arm'\?\)"),
        ("hand:arm,stifness=3", r"has no 'stifness' \(did you mean 'stiffness'\?\)"),
        ("hand:arm,", "has no ''; there are: mass, damping"),
        ("hand:arm,mass=1,mass=1", "'mass=1' must be KEY=NUMBER, each key once"),
        ("hand:arm,mass=heavy", "'mass=heavy' must be KEY=NUMBER"),
        ("hand:arm,mass=nan", "mass of the hand is nan kg"),
        ("hand:arm,max-force=0", "largest force of the device is 0.0 N"),
        ("hand:arm,axes=4", "axes of the hand is 4.0; it must be between 1 and 3"),
        ("hand:arm,motion=udp:1", "no hand intends 'udp:1'"),
        ("hand:arm,motion=skripted", "did you mean 'scripted'"),
        ("hand:arm,axes=1,motion=scripted", "axes or a motion, not both"),
    ],
)
def test_a_wrong_text_is_refused_in_a_sentence(text, message):
    with pytest.raises(SettingsError, match=message):
        check_operator(text)


def made(text, insertions=1):
    return make_operator(text, insertions=insertions, seed=1, say=print, warn=print)


def test_the_master_s_hand_intends_the_scripted_motion_palpation_or_a_recording(tmp_path):
    file = tmp_path / "hand.csv"
    file.write_text("t_s,position_m\n" + "".join(f"{n / 100},{n / 1000}\n" for n in range(200)))
    for text, intended in (
        ("hand:arm", "scripted"),
        ("hand:arm,axes=2", "palpation:axes=2"),
        (f"hand:arm,max-force=3,motion=trace:{file}", f"trace:{file}"),
    ):
        hand, alone = made(text), made(intended)
        operator = hand.operator
        assert isinstance(operator, YieldingOperator)
        assert (hand.file, operator.duration_us) == (alone.file, alone.operator.duration_us)
        for t_us in range(0, 1_500_000, 1000):
            operator.feel(t_us, (0.0,) * operator.axes)
            assert operator.sample(t_us).position_m == pytest.approx(alone.operator.sample(t_us).position_m, abs=1e-12)
    assert operator.capabilities.max_force_n == 3.0


def test_a_virtual_link_has_the_same_hand_from_text_as_from_an_object(tmp_path):
    file = tmp_path / "wall.toml"
    file.write_text(WALL)

    def held_n(operator):
        link = hn.virtual_link(scene=str(file), operator=operator, forward="delay=10ms", feedback="delay=10ms")
        link.run(seconds=2.0)
        return link.master_samples()["held_n"]

    text = "hand:finger,stiffness=100,max-force=2"
    own = scripted_yielding(text, 1, 100, np.random.default_rng([0, 3]))
    assert np.array_equal(held_n(text), held_n(own))
    assert not np.array_equal(held_n("hand:stiff-arm"), held_n(text))


def test_a_virtual_link_gives_the_hand_the_axes_of_its_scene():
    link = hn.virtual_link(scene="phantom", operator="hand:arm")
    link.run(seconds=0.1)
    assert "position_z_m" in link.master_samples()


@pytest.mark.parametrize("text", ["hand:arm,axes=2", "hand:arm,motion=scripted", "scripted"])
def test_a_virtual_link_refuses_other_text(text):
    with pytest.raises(SettingsError, match="operator"):
        hn.virtual_link(operator=text)


def test_a_sweep_refuses_a_hand_that_yields(tmp_path):
    with pytest.raises(SettingsError, match="replays one motion for every codec"):
        touched("paper:1", "hand:arm", 1000.0, tmp_path)
