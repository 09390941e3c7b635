"""Golomb-Rice codes: unpacking returns what was packed, and no payload does harm."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hapticnet.errors import PeerError
from hapticnet_literature.golomb_rice import bits_of, pack_integers, unpack_integers
from hapticnet_literature.residuals import LARGEST_PARAMETER, first_rice, fits, folded, next_rice

parameters = st.integers(0, LARGEST_PARAMETER)
residuals = st.lists(st.integers(-(2**12), 2**12).map(float), min_size=1, max_size=3).map(tuple)


def packed(residual, parameter):
    return pack_integers(map(folded, residual), parameter)


@given(residuals, parameters)
@example((0.0, -0.0, 0.0), 0)
def test_unpacking_returns_what_was_packed(residual, parameter):
    codes = packed(residual, parameter)
    integers = unpack_integers(codes, len(residual), parameter)
    assert integers == tuple(map(folded, residual))
    assert tuple(-(code + 1) // 2 if code % 2 else code // 2 for code in integers) == residual
    assert len(codes) == (sum(bits_of(integer, parameter) for integer in integers) + 7) // 8


@given(residuals, parameters)
def test_a_residual_is_coded_exactly_when_its_codes_are_no_longer_than_float32(residual, parameter):
    assert fits(residual, parameter) == (len(packed(residual, parameter)) <= 4 * len(residual))


def test_codes_are_those_of_the_definition():
    # -2 folds onto 3: one one, a zero, the bit 1. 1 folds onto 2: one one, a zero, the bit 0.
    assert packed((-2.0, 1.0), 1) == bytes([0b101_100_00])
    assert packed((0.0,), 0) == b"\0"
    assert packed((), 0) == b""


@given(st.binary(max_size=40), st.integers(1, 3), parameters)
@example(b"\xff" * 40, 1, 0)
@example(b"", 1, 0)
def test_data_is_refused_unless_it_is_the_code_of_what_it_unpacks_to(data, count, parameter):
    try:
        integers = unpack_integers(data, count, parameter)
    except PeerError:
        return
    assert pack_integers(integers, parameter) == data


@pytest.mark.parametrize(
    ("data", "wrong"),
    [
        (b"", "end within"),
        (b"\xff\xff", "end within"),  # ones without an end
        (b"\xfe", "end within"),  # no room for the lowest bits
        (b"\x01", "hold more"),  # padding that is not zero
        (b"\x00\x00", "hold more"),  # a byte too many
    ],
)
def test_invalid_codes_are_refused(data, wrong):
    with pytest.raises(PeerError, match=wrong):
        unpack_integers(data, 1, 2)


def test_a_huge_residual_is_refused_without_being_packed():
    assert not fits((1e300,), 0)
    assert not fits((-1e300,), LARGEST_PARAMETER)


def after(rice, *residuals):
    for residual in residuals:
        rice = next_rice(rice, residual)
    return rice


def test_the_parameter_follows_the_running_mean_up_and_down():
    rice = first_rice(4)
    assert rice.parameter == 2
    rice = after(rice, *[(500.0, -500.0)] * 100)
    assert rice.parameter == 10  # of 999 and 1000: 2^10 is the first power that is no less
    assert after(rice, *[(0.0, 0.0)] * 200).parameter == 0


@given(st.lists(st.integers(-(2**60), 2**60).map(float), max_size=200))
def test_the_parameter_stays_in_range(integers):
    rice = first_rice(4)
    for integer in integers:
        rice = next_rice(rice, (integer,))
        assert 0 <= rice.parameter <= LARGEST_PARAMETER
