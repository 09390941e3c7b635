"""What PlotJuggler is sent: valid JSON in Unix time, one datagram per sample, none of them too large."""

import json
import math
from array import array

from hapticnet.node.recording import master_columns
from hapticnet.runtime.stream import Series
from hapticnet.runtime.stream_sender import messages

LARGEST_MESSAGE = 2048
"""PlotJuggler's buffer of a datagram [B]."""


def sent(columns, *rows, path=("master",), offset_s=1000.0):
    series = Series(3, path, columns, offset_s)
    for row in rows:
        series.add(row)
    numbers = array("d", series.take())
    assert series.take() == b""
    assert numbers[0] == 3.0
    return [json.loads(each, parse_constant=None) for each in messages(json.loads(series.definition), numbers[1:])]


def test_each_sample_is_one_message_with_its_time_in_seconds():
    assert sent(("position_m", "held_n"), (1_500_000, 0.01, 2.0), (1_501_000, 0.02, 2.5)) == [
        {"timestamp": 1001.5, "master": {"position_m": 0.01, "held_n": 2.0}},
        {"timestamp": 1001.501, "master": {"position_m": 0.02, "held_n": 2.5}},
    ]


def test_a_path_nests_and_a_name_of_any_characters_stays_valid_json():
    (message,) = sent(("force_n",), (0, 1.0), path=("slave", 'left "hand"/\n'))
    assert message["slave"] == {'left "hand"/\n': {"force_n": 1.0}}


def test_what_json_cannot_express_is_left_out_because_plotjuggler_would_stop():
    (message,) = sent(("a", "b", "c"), (0, math.nan, 1.0, -math.inf))
    assert message["master"] == {"b": 1.0}


def test_the_largest_sample_fits_into_plotjugglers_buffer():
    columns = (*master_columns(3)[1:], "forces_received")
    series = Series(0, ("m" * 64,), columns, 1.7e9)
    series.add((2**40, *(-1.23456789012e-3 for _ in columns)))
    (message,) = messages(json.loads(series.definition), array("d", series.take())[1:])
    assert len(message) < LARGEST_MESSAGE
