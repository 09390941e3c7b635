"""What a scene says about the force near the tip is true now, whenever it was last asked."""

from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue

SKIN = Tissue(name="skin", rest_position_m=0.01, stiffness_n_per_m=100.0, breach_force_n=1.0)
OUTSIDE, PRESSED, BEYOND = (PositionSample(0, (x_m,)) for x_m in (0.005, 0.015, 0.025))


def test_an_bound_from_before_a_breach_or_a_withdrawal_is_not_given_again():
    scene = Scene([SKIN])
    scene.step(PRESSED)
    pressed = scene.stiffness_bound()
    assert pressed.stiffness_n_per_m == 100.0
    scene.step(BEYOND)  # nobody asks here: the session sends every position
    scene.step(PRESSED)
    assert scene.stiffness_bound().stiffness_n_per_m == 0.0
    scene.step(OUTSIDE)
    scene.step(PRESSED)
    assert scene.stiffness_bound() == pressed
