"""Means over recordings, and grids of settings."""

import numpy as np
import pytest

from hapticnet.codec.registry import make_codec
from hapticnet.errors import SettingsError
from hapticnet.experiment.comparison import codec_label, compare
from hapticnet.experiment.grid import grid_codecs
from hapticnet.experiment.summary import blocks, means, t_quantile
from hapticnet.experiment.trials import Trial
from hapticnet.perception import WeberLaw


@pytest.mark.parametrize(
    ("freedom", "quantile"), [(1, 12.706), (2, 4.303), (3, 3.182), (9, 2.262), (10, 2.228), (30, 2.042), (1000, 1.962)]
)
def test_the_quantiles_are_those_of_printed_tables(freedom, quantile):
    assert t_quantile(freedom) == pytest.approx(quantile, abs=5e-4)


def test_a_mean_has_the_t_interval_over_recordings_and_optima_are_averaged_too():
    t_us = np.arange(600) * 1000
    trials = [Trial(name=str(n), t_us=t_us, stimuli=n + np.sin(t_us * 1e-5)[:, np.newaxis]) for n in (1, 2, 3)]
    rows = compare(trials, [make_codec("deadband", WeberLaw()), make_codec("raw", WeberLaw())])
    single = blocks(rows)
    assert [block.trial for block in single] == ["1", "2", "3"]
    (mean,) = means(single)
    assert (mean.trial, mean.recordings) == (None, 3)
    deadband, raw, hold, lines = mean.lines
    sent = [row.cost.sent for row in rows if row.codec == "deadband"]
    assert deadband.values["sent"] == pytest.approx(np.mean(sent))
    assert deadband.half_widths["sent"] == pytest.approx(4.302653 * np.std(sent, ddof=1) / np.sqrt(3))
    assert raw.values["packet_rate_reduction"] == 0.0
    assert hold.values["over_optimum"] == 1.0 > lines.values["over_optimum"]
    assert means(single[:1]) == []


def test_a_parameter_applies_to_the_codecs_that_have_it_unless_the_name_fixes_it():
    names = ["raw", "deadband", "least-squares", "least-squares:updates=3"]
    codecs = grid_codecs(names, {"multiplier": [1.0, 2.0], "updates": [4.0, 5.0]})
    assert [(codec_label(codec), codec.law.multiplier) for codec in codecs if codec.name == "least-squares"] == [
        (f"least-squares:updates={updates}", multiplier) for multiplier in (1.0, 2.0) for updates in (4, 5, 3)
    ]
    assert [codec.name for codec in codecs].count("deadband") == 2
    assert [codec.name for codec in codecs].count("raw") == 1
    with pytest.raises(SettingsError, match="no codec here has a parameter 'gain' for a grid; there are: multiplier,"):
        grid_codecs(names, {"gain": [1.0]})
