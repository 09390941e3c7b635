"""How a scene looks: shapes as bytes, and which of them are sent when."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import PeerError, SampleError
from hapticnet.scene.shapes import AGAIN_US, AT_ONCE, EVERY_US, Shape, ShapeFeed, pack_shape, unpack_shapes

BALL = Shape("sphere", (0.03, 0.0, 0.01), (0.012,))


def sent(feed: ShapeFeed, now_us: int) -> dict[int, Shape]:
    data = feed.due(now_us)
    return {} if data is None else unpack_shapes(data)[1]


def test_shapes_arrive_as_they_were_sent_to_a_tenth_of_a_millimetre():
    box = Shape("box", (0.1, -0.2, 0.00004), (0.01, 0.02, 0.03), (0.0, 0.6, 0.8), (1.0, 0.0, 0.0))
    count, found = unpack_shapes(ShapeFeed(lambda: [BALL, box]).due(0))
    assert count == 2
    assert found[0] == Shape("sphere", (0.03, 0.0, 0.01), (0.012, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    assert found[1] == box._replace(at_m=(0.1, -0.2, 0.0))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (("cone",), "a shape is 'cone'; it must be one of: plane, sphere"),
        (("sphere", (math.nan,)), "at_m of a sphere is .nan.; it must be at most three finite numbers"),
        (("box", (), (math.inf,)), "size_m of a box"),
    ],
)
def test_what_is_no_shape_is_refused_with_the_value(wrong, words):
    with pytest.raises(SampleError, match=words):
        pack_shape(wrong)


@given(st.binary(max_size=200))
def test_bytes_from_a_network_are_shapes_or_refused(data):
    try:
        count, found = unpack_shapes(data)
    except PeerError:
        return
    assert count > 0
    assert all(place < count and all(map(math.isfinite, shape.at_m)) for place, shape in found.items())


def test_what_stands_still_is_sent_once_a_second_and_what_moves_thirty_times():
    place = [0.0]
    feed = ShapeFeed(lambda: [BALL, BALL._replace(at_m=(place[0],))])
    assert sent(feed, 0).keys() == {0, 1}
    numbers = []
    for now_us in range(1000, 2 * AGAIN_US, 1000):
        place[0] += 0.0005
        numbers.append(len(sent(feed, now_us)))
    assert sum(each > 0 for each in numbers) == pytest.approx(2 * AGAIN_US / EVERY_US, abs=3)
    assert numbers.count(2) == 1
    assert not sent(feed, 2 * AGAIN_US)  # nothing moved since, and it is not time
    assert sent(feed, 0)  # a clock that goes back does not stop the picture


def test_of_many_moving_shapes_each_has_its_turn():
    now = [0.0]
    feed = ShapeFeed(lambda: [Shape("sphere", (now[0], float(each))) for each in range(100)])
    seen: dict[int, int] = {}
    for turn in range(50):
        now[0] += 0.01
        found = sent(feed, turn * EVERY_US)
        assert len(found) == AT_ONCE
        seen |= dict.fromkeys(found, turn)
    assert len(seen) == 100
    assert min(seen.values()) >= 50 - math.ceil(100 / AT_ONCE)
    assert len(ShapeFeed(lambda: [BALL] * 100).due(0)) < 1150  # so that it fits with frame and seal
