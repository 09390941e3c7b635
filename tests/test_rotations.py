"""Rotations: quaternions, rotation vectors and matrices agree with each other and with SciPy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hapticnet.rotations import (
    NO_TURN,
    inverse,
    matrix_of,
    normalised,
    product,
    quaternion_of,
    rotated,
    toward,
    vector_near,
)

VECTORS = st.tuples(*[st.floats(-10.0, 10.0)] * 3)  # up to some turns
QUATERNIONS = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda each: math.hypot(*each) > 1e-3).map(normalised)


def close(values):
    return pytest.approx(values, abs=1e-9)


def negative(turn):
    return tuple(-each for each in turn)


def same(turn):
    """The quaternion of either sign: what it turns."""
    return pytest.approx(np.outer(turn, turn), abs=1e-9)


@given(VECTORS)
def test_quaternion_and_matrix_of_a_vector_are_those_of_scipy(vector):
    wanted = Rotation.from_rotvec(vector)
    assert np.array(matrix_of(vector)) == close(wanted.as_matrix())
    assert np.outer(*[quaternion_of(vector)] * 2) == same(wanted.as_quat())


@given(VECTORS)
def test_a_matrix_is_orthonormal_and_no_mirror(vector):
    rows = np.array(matrix_of(vector))
    assert rows @ rows.T == close(np.eye(3))
    assert np.linalg.det(rows) == pytest.approx(1.0)


@given(QUATERNIONS)
def test_a_quaternion_of_either_sign_comes_back_from_its_vector_of_half_a_turn_at_most(turn):
    for each in (turn, negative(turn)):
        vector = vector_near(each)
        assert math.hypot(*vector) <= math.pi + 1e-9
        back = quaternion_of(vector)
        assert np.outer(back, back) == same(turn)


@given(st.tuples(*[st.floats(-1.8, 1.8)] * 3))
def test_a_vector_below_half_a_turn_comes_back_from_its_quaternion(vector):
    assert vector_near(quaternion_of(vector)) == close(vector)


@given(QUATERNIONS, VECTORS)
def test_the_vector_near_another_is_the_nearest_of_the_equal_ones(turn, last):
    for each in (turn, negative(turn)):
        vector = vector_near(each, last)
        back = quaternion_of(vector)
        assert np.outer(back, back) == same(turn)
        if (length := math.hypot(*vector_near(turn))) > 1e-6:
            axis = np.array(vector_near(turn)) / length
            others = [(length + math.tau * turns) * axis for turns in range(-4, 5)]
            assert math.dist(vector, last) <= min(math.dist(other, last) for other in others) + 1e-9


def test_a_vector_goes_on_over_many_turns_whatever_the_sign_of_the_quaternion():
    last = (0.0, 0.0, 0.0)
    for step in range(1, 1500):
        turn = quaternion_of((0.006 * step, 0.0, -0.008 * step))
        after = vector_near(negative(turn) if step % 2 else turn, last)
        assert math.dist(after, last) < 0.0101
        last = after
    assert last == pytest.approx((0.6 * 14.99, 0.0, -0.8 * 14.99))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_whole_turns_keep_the_axis_of_the_last_vector_although_rounding_has_made_another(sign):
    turn, last = (1e-16, 0.0, 0.0, sign), (0.0, 0.01, math.tau)
    assert vector_near(turn, last) == close(tuple(math.tau * each / math.hypot(*last) for each in last))
    assert vector_near(turn, (0.0, 0.0, 0.1)) == close((0.0, 0.0, 0.0))
    assert vector_near((0.0, 0.0, 0.0, sign)) == (0.0, 0.0, 0.0)


@given(QUATERNIONS, QUATERNIONS, VECTORS)
def test_a_product_turns_by_the_second_factor_first_and_the_inverse_turns_back(second, first, vector):
    turned = rotated(rotated(vector, first), second)
    both = product(second, first)
    assert rotated(vector, both) == close(turned)
    assert rotated(turned, inverse(both)) == close(vector)
    assert rotated(vector, negative(both)) == close(turned)
    assert product(both, inverse(both)) == close(NO_TURN)


@given(VECTORS, VECTORS)
def test_quaternion_and_matrix_turn_a_vector_alike(about, vector):
    assert rotated(vector, quaternion_of(about)) == close(tuple(np.array(matrix_of(about)) @ vector))


@given(QUATERNIONS, QUATERNIONS, st.floats(0.0, 3.2))
def test_a_turn_toward_another_goes_the_short_way_and_no_further_than_allowed(turn, to, most_rad):
    between = toward(turn, to, most_rad)
    whole, done, left = (
        math.hypot(*vector_near(product(b, inverse(a)))) for a, b in ((turn, to), (turn, between), (between, to))
    )
    assert done == pytest.approx(min(most_rad, whole), abs=1e-7)
    assert done + left == pytest.approx(whole, abs=1e-7)
