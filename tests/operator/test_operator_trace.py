import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import FileError, SampleError, SettingsError
from hapticnet.node.recording import Recording, master_columns, slave_columns
from hapticnet.operator.trace import TraceOperator, load_trace
from tests.recordings.session_cases import write_csv


def make(t_s, *axes_m, loop=False):
    t_us = np.round(np.array(t_s, float) * 1e6).astype(np.int64)
    return TraceOperator(t_us, np.column_stack([np.array(axis, float) for axis in axes_m]), loop=loop)


@pytest.fixture
def trace_file(tmp_path):
    def write(content):
        path = tmp_path / "trace.csv"
        path.write_text(content)
        return path

    return write


def test_time_starts_at_the_first_sample_on_up_to_three_axes():
    epoch_s = 1.7e9
    operator = make([epoch_s, epoch_s + 1.0], [0.0, 1.0], [0.0, 10.0], [5.0, 5.0])
    assert (operator.axes, operator.duration_us) == (3, 1_000_000)
    assert operator.sample(500_000).position_m == pytest.approx((0.5, 5.0, 5.0))


@pytest.mark.parametrize(
    ("t_us", "position_m"), [(-1, 1.0), (-(2**63), 1.0), (10**6, 3.0), (10**6 + 1, 3.0), (2**63, 3.0)]
)
def test_the_ends_of_a_trace_are_held_before_and_after_it(t_us, position_m):
    assert make([0.0, 1.0], [1.0, 3.0]).sample(t_us) == (t_us, (position_m,))


def test_a_loop_starts_again_and_has_no_duration():
    operator = make([5.0, 6.0, 7.0], [0.0, 1.0, 4.0], loop=True)
    assert operator.duration_us is None
    for t_us in range(0, 2_000_000, 123_457):
        assert operator.sample(t_us + 6_000_000) == (t_us + 6_000_000, operator.sample(t_us).position_m)


@given(
    steps=st.lists(st.tuples(st.integers(1, 10**7), st.floats(-1e15, 1e15)), min_size=2, max_size=30),
    t_us=st.integers(-(10**6), 4 * 10**8),
    loop=st.booleans(),
)
def test_a_position_lies_between_its_neighbours_at_any_time(steps, t_us, loop):
    times_us = np.cumsum([step for step, _ in steps])
    values_m = [value for _, value in steps]
    operator = make(times_us * 1e-6, values_m, loop=loop)
    (position_m,) = operator.sample(t_us).position_m
    at_us = t_us % int(times_us[-1] - times_us[0]) if loop else t_us
    expected_m = np.interp(at_us, times_us - times_us[0], values_m)
    assert position_m == pytest.approx(expected_m, abs=1e-9 * max(map(abs, values_m)))


@pytest.mark.parametrize(
    ("t_s", "x_m", "message"),
    [
        ([0.0], [1.0], "1 samples"),
        ([], [], "0 samples"),
        ([0.0, 1.0, 0.5], [1.0, 2.0, 3.0], "sample 2: time 500000 us follows 1000000 us"),
        ([0.0, 1.0, 1.0000001], [1.0, 2.0, 3.0], "expected 1 us later or more"),
        ([0.0, 1.0], [1.0, math.inf], "sample 1: position is inf m"),
        ([0.0, 1.0], [1e300, 1.0], r"sample 0: position is 1e\+300 m; it must be within ±1e\+15 m"),
    ],
)
def test_a_trace_that_cannot_be_played_is_refused_with_the_sample(t_s, x_m, message):
    with pytest.raises(SampleError, match=message):
        make(t_s, x_m)


@pytest.mark.parametrize("shape", [(2,), (2, 4), (2, 0), (3, 1)])
def test_positions_of_the_wrong_shape_are_refused(shape):
    with pytest.raises(SampleError, match="positions of shape"):
        TraceOperator(np.array([0, 1]), np.zeros(shape))


def test_a_file_is_loaded_by_column_names(trace_file):
    operator, notes = load_trace(trace_file("force_n,position_m,t_s\n9,0.0,10.0\n9,0.1,10.5\n"))
    assert (operator.axes, operator.duration_us) == (1, 500_000)
    assert operator.sample(250_000).position_m == pytest.approx((0.05,))
    assert notes == ("position: position_m, chosen by its name",)


@pytest.mark.parametrize("columns", [slave_columns(1), master_columns(1)])
def test_hapticnets_own_recordings_are_played(tmp_path, columns):
    recording = Recording(columns)
    for step in range(3):
        recording.add((1000.0 * step, 0.5 * step, *[math.nan] * (len(columns) - 2)))
    write_csv(tmp_path / "own.csv", recording.table())
    operator, _ = load_trace(tmp_path / "own.csv")
    assert operator.sample(1500).position_m == (0.75,)


def test_units_other_columns_and_looping_can_be_chosen(trace_file):
    path = trace_file("# rig\r\nstamp,x [mm],y,note\r\n0,1,2,start\r\n1,3,4,end\r\n\r\n")
    operator, notes = load_trace(path, position="y,x", loop=True)
    assert operator.sample(500).position_m == pytest.approx((3.0, 0.002))
    assert len(notes) == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("t_s,x,y\n0,1,1\n1,2,1\n", r"which column\? there are t_s, x, y"),
        ("t_s,position_m\n0,1\n# c\n1,nan\n", 'line 4, column "position_m": no number'),
        ("t_s,position_m\n0,1\n\n1,2\n1,3\n", "trace sample 2: time 1000000 us follows 1000000 us"),
        ("t_s,position_m\n0,1\n1e15,1\n", "times up to 1e"),
    ],
)
def test_a_file_that_cannot_be_played_is_refused(trace_file, content, message):
    with pytest.raises(FileError, match=message):
        load_trace(trace_file(content))


def test_too_many_position_columns_are_refused(trace_file):
    with pytest.raises(SettingsError, match="4 position columns are chosen"):
        load_trace(trace_file("t_s,a,b,c,d\n0,1,1,1,1\n"), position="a,b,c,d")
