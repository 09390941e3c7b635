import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.measure.metrics import error_report, worst_window_packets
from hapticnet.measure.running_error import RunningError
from hapticnet.perception import WeberLaw

LAW = WeberLaw(weber_fraction=0.1, floor_n=0.05)


def test_errors_equal_those_worked_out_by_hand():
    true = np.array([[1.0], [2.0], [0.0], [3.0]])
    applied = np.array([[1.0], [1.9], [0.05], [2.0]])
    report = error_report(LAW, true, applied)
    assert report.rmse_n == pytest.approx(np.sqrt((0.1**2 + 0.05**2 + 1.0) / 4))
    assert report.max_error_n == 1.0
    assert report.exceed_jnd_fraction == 0.25


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, 9)), max_size=40))
def test_the_running_account_equals_the_whole_array(rows):
    data = np.array(rows).reshape(-1, 4)
    true, applied = data[:, :2], data[:, 2:]
    running = RunningError(LAW)
    for t, a in zip(true.tolist(), applied.tolist(), strict=True):
        running.add(tuple(t), tuple(a))
    report, whole = running.report(), error_report(LAW, true, applied)
    assert report.rmse_n == pytest.approx(whole.rmse_n)
    assert report.max_error_n == pytest.approx(whole.max_error_n)
    assert report.exceed_jnd_fraction == whole.exceed_jnd_fraction


@given(st.lists(st.integers(0, 1000), max_size=60), st.integers(1, 300))
def test_worst_window_equals_counting_every_window(times, window):
    expected = max((sum(t <= other < t + window for other in times) for t in times), default=0)
    assert worst_window_packets(np.array(times, dtype=np.int64), window) == expected
