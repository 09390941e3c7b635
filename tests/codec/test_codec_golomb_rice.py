"""Golomb–Rice codes: what goes in comes out, and nothing that comes in does harm."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hapticnet.codec.payload.golomb_rice import LARGEST_PARAMETER, RiceParameter, pack_integers, unpack_integers
from hapticnet.errors import PeerError

parameters = st.integers(0, LARGEST_PARAMETER)


@given(st.lists(st.integers(-(2**40), 2**40), max_size=3), parameters)
@example([0, 0, 0], 0)
def test_what_was_packed_is_unpacked_and_never_longer_than_asked(integers, parameter):
    packed = pack_integers(integers, parameter, most_bytes=12)
    if packed is not None:
        assert len(packed) <= 12
        assert unpack_integers(packed, len(integers), parameter) == tuple(integers)


@given(st.lists(st.integers(-60, 60), min_size=1, max_size=3), parameters)
def test_integers_are_left_out_exactly_when_their_codes_would_be_too_long(integers, parameter):
    folded = [2 * integer if integer >= 0 else -2 * integer - 1 for integer in integers]
    size = (sum((value >> parameter) + 1 + parameter for value in folded) + 7) // 8
    assert pack_integers(integers, parameter, most_bytes=size - 1) is None
    packed = pack_integers(integers, parameter, most_bytes=size)
    assert packed is not None
    assert len(packed) == size


def test_codes_are_those_of_the_definition():
    # -2 folds onto 3: one one, a zero, the bit 1. 1 folds onto 2: one one, a zero, the bit 0.
    assert pack_integers([-2, 1], 1, most_bytes=4) == bytes([0b101_100_00])
    assert pack_integers([0], 0, most_bytes=1) == b"\0"
    assert pack_integers([], 0, most_bytes=1) == b""


@given(st.binary(max_size=40), st.integers(1, 3), parameters)
@example(b"\xff" * 40, 1, 0)
@example(b"", 1, 0)
def test_what_is_unpacked_is_what_would_have_been_packed_or_is_refused(data, count, parameter):
    try:
        integers = unpack_integers(data, count, parameter)
    except PeerError:
        return
    assert pack_integers(integers, parameter, most_bytes=len(data)) == data


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
def test_what_cannot_have_been_packed_is_refused(data, wrong):
    with pytest.raises(PeerError, match=wrong):
        unpack_integers(data, 1, 2)


def test_an_integer_of_any_size_costs_no_more_than_its_refusal():
    assert pack_integers([10**300], 0, most_bytes=4) is None
    assert pack_integers([-(10**300)], LARGEST_PARAMETER, most_bytes=4) is None


def test_the_parameter_follows_the_running_mean_up_and_down():
    rice = RiceParameter(4)
    assert rice.value == 2
    for _ in range(100):
        rice.add((500, -500))
    assert rice.value == 10  # of 999 and 1000: 2^10 is the first power that is no less
    for _ in range(200):
        rice.add((0, 0))
    assert rice.value == 0


@given(st.lists(st.integers(-(2**60), 2**60), max_size=200))
def test_the_parameter_stays_in_range_whatever_is_counted(integers):
    rice = RiceParameter(4)
    for integer in integers:
        rice.add((integer,))
        assert 0 <= rice.value <= LARGEST_PARAMETER


def test_two_bits_an_integer_is_what_adaptation_makes_of_small_ones():
    rice = RiceParameter(1000)
    for _ in range(200):
        rice.add((0,))
    packed = pack_integers([0, 0, 0, 0], rice.value, most_bytes=8)
    assert packed is not None
    assert len(packed) == 1
