"""Many laws at once count what each counts alone."""

import numpy as np
import pytest
from codec_cases import anything, laws
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec import threshold_sweep
from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.threshold_sweep import sweep_deadband
from hapticnet.errors import SampleError
from hapticnet.measure.metrics import error_report
from hapticnet.perception import WeberLaw

CONDITIONS = [WeberLaw(multiplier=multiplier) for multiplier in np.geomspace(0.01, 20.0, 11)]


@pytest.fixture(scope="module", params=["plain", "compiled"])
def _way(request):
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "compiled":
            patch.setattr(threshold_sweep, "COMPILE_ABOVE_SAMPLES", -1)
        yield


def assert_counts_what_each_counts(stimuli, laws):
    swept = sweep_deadband(stimuli, laws)
    t_us = np.arange(len(stimuli), dtype=np.int64)
    encodings = [encode_array(Deadband(law=law), t_us, stimuli) for law in laws]
    reports = [error_report(law, stimuli, one.decoded) for law, one in zip(laws, encodings, strict=True)]
    assert swept.packets.tolist() == [len(one.sent) for one in encodings]
    # The square of a difference below 1e-154 is zero.
    assert swept.max_error_n.tolist() == pytest.approx([report.max_error_n for report in reports], rel=0, abs=1e-150)
    assert swept.exceed_jnd_fraction.tolist() == [report.exceed_jnd_fraction for report in reports]
    assert swept.rmse_n.tolist() == pytest.approx([report.rmse_n for report in reports], rel=1e-9, abs=1e-150)


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize("samples", [0, 1, 2, 7, 2000, 2001])
def test_a_sweep_agrees_with_the_codec_law_by_law(samples):
    walk = np.cumsum(np.random.default_rng(samples).normal(0.0, 0.05, (samples, 1)), axis=0)
    assert_counts_what_each_counts(walk, CONDITIONS)
    if samples:
        assert np.diff(sweep_deadband(walk, CONDITIONS).packets)[0] <= 0


@pytest.mark.usefixtures("_way")
@given(npst.arrays(np.float64, st.tuples(st.integers(0, 30), st.just(1)), elements=anything), st.lists(laws))
def test_a_sweep_agrees_on_forces_of_every_size_and_any_law(stimuli, laws):
    assert_counts_what_each_counts(stimuli, laws)


@pytest.mark.usefixtures("_way")
def test_several_axes_are_swept_too():
    assert_counts_what_each_counts(np.random.default_rng(1).normal(1.0, 0.1, (300, 3)), CONDITIONS)


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e300])
def test_what_is_not_finite_or_out_of_range_is_refused_before_anything_is_swept(bad):
    with pytest.raises(SampleError, match="sample 2: stimulus is"):
        sweep_deadband(np.array([[1.0], [1.0], [bad], [1.0]]), CONDITIONS)
