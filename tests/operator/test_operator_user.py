"""Objects of the user's in the place of an operator."""

import math

import pytest

from hapticnet.errors import SettingsError, UserCodeError
from hapticnet.operator.base import UserOperator
from hapticnet.samples import PositionSample


class Hand:
    def __init__(self, at=lambda t_us: 1e-9 * t_us, **attributes):
        self.at = at
        vars(self).update(attributes)

    def sample(self, t_us):
        return self.at(t_us)


class FeelingHand(Hand):
    felt = ()

    def feel(self, t_us, force_n):
        if force_n == (9.0,):
            raise OSError("the motor is hot")
        self.felt = t_us, force_n


def test_a_class_with_sample_is_an_operator():
    hand = UserOperator(Hand())
    assert hand.sample(1_000_000) == PositionSample(1_000_000, (0.001,))
    assert (hand.axes, hand.duration_us, hand.capabilities.max_force_n) == (1, None, math.inf)
    hand.feel(0, (1.0,))  # a hand that does not feel is asked nothing


def test_it_may_declare_axes_and_a_duration_and_its_own_time_is_not_believed():
    hand = UserOperator(Hand(lambda _: PositionSample(-5, (1.0, 2.0)), axes=2, duration_us=3_000_000.0))
    assert (hand.axes, hand.duration_us) == (2, 3_000_000)
    assert hand.sample(8) == PositionSample(8, (1.0, 2.0))


def test_it_feels_the_force_and_what_it_raises_is_its_own_fault():
    made = FeelingHand()
    hand = UserOperator(made)
    hand.feel(5, (1.0,))
    assert made.felt == (5, (1.0,))
    with pytest.raises(
        UserCodeError, match=r"^FeelingHand.feel raised OSError: the motor is hot \(test_operator_user.py"
    ):
        hand.feel(6, (9.0,))


def test_a_wrong_position_is_an_error_of_the_user():
    for at, message in (
        (lambda _: "here", r"^Hand.sample returned 'here'; it must return a finite number \[m\]$"),
        (lambda _: (0.0, 0.0), r"^Hand.sample returned \(0.0, 0.0\)"),
        (lambda _: [].pop(), r"^Hand.sample raised IndexError: pop from empty list"),
    ):
        with pytest.raises(UserCodeError, match=message):
            UserOperator(Hand(at)).sample(0)


@pytest.mark.parametrize(
    "attributes",
    [
        {"duration_us": 0},
        {"duration_us": "long"},
        {"duration_us": 1.5},
        {"feel": 3},
        {"max_force_n": "three"},
        {"max_force_n": 0},
    ],
)
def test_attributes_that_cannot_be_used_are_refused(attributes):
    with pytest.raises(SettingsError, match=r"^operator own.py:Hand: "):
        UserOperator(Hand(**attributes), "operator own.py:Hand")
