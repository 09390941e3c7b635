"""Codecs side by side: the rows, whatever the codec and however many processes."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.errors import SampleError, SettingsError
from hapticnet.experiment.comparison import compare
from hapticnet.experiment.trials import Trial
from hapticnet.perception import WeberLaw

CODECS = every_codec()


def trial(name="sine", samples=800, peak_n=2.0, axes=1):
    t_us = np.arange(samples) * 1000
    force = 2.0 + peak_n * np.sin(t_us[:, np.newaxis] * 5e-6 + np.arange(axes))
    return Trial(name=name, t_us=t_us, stimuli=force)


def test_a_row_for_each_recording_loss_and_codec_in_that_order():
    codecs = [make_codec("deadband", WeberLaw(multiplier=m)) for m in (1.0, 2.0)]
    seen = []
    rows = compare([trial("a"), trial("b")], codecs, loss=(0.0, 0.2), seed=3, on_row=seen.append)
    assert [(row.trial, row.loss, row.multiplier) for row in rows] == [
        (name, loss, multiplier) for name in "ab" for loss in (0.0, 0.2) for multiplier in (1.0, 2.0)
    ]
    assert seen == rows
    assert rows[2].quality.rmse_n > rows[0].quality.rmse_n


def test_the_number_of_processes_changes_no_figure():
    trials = [trial("a", axes=2), trial("b", samples=500, axes=2)]
    codecs = [make_codec(name, WeberLaw()) for name in CODECS]
    alone, together = (
        [replace(row, nanoseconds_per_sample=0.0) for row in compare(trials, codecs, loss=0.1, seed=1, jobs=jobs)]
        for jobs in (1, 2)
    )
    assert alone == together


DEFAULT_LAW = WeberLaw()


@dataclass(frozen=True)
class Own:
    """A codec that is not registered: it sends what a deadband of half the threshold sends."""

    name: ClassVar[str] = "own"
    needs_position: ClassVar[bool] = True
    law: WeberLaw = DEFAULT_LAW
    share: float = 0.5

    def _inner(self):
        return make_codec("deadband", replace(self.law, multiplier=self.share * self.law.multiplier))

    def encoder(self, axes):
        return self._inner().encoder(axes)

    def decoder(self, axes):
        return self._inner().decoder(axes)

    def encode_array(self, t_us, stimuli, positions=None):
        return encode_array(self._inner(), t_us, stimuli, positions)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_codec_of_ones_own_is_compared_and_labelled_without_being_registered(jobs):
    local = type("Local", (Own,), {})  # which no process could unpickle
    plain, changed, half = compare(
        [trial()], [local(), local(share=0.25), make_codec("deadband", WeberLaw(multiplier=0.5))], jobs=jobs
    )
    assert (plain.label, changed.label) == ("own", "own:share=0.25")
    assert plain.at_rest
    assert plain.cost.sent == half.cost.sent < changed.cost.sent


def test_an_infinite_figure_is_none_in_a_flat_row():
    still = Trial(name="still", t_us=np.arange(5) * 1000, stimuli=np.zeros((5, 1)))
    assert compare([still], [make_codec("raw", WeberLaw())])[0].flat()["psnr_db"] is None


def test_what_cannot_be_compared_is_refused():
    codec = make_codec("deadband", WeberLaw())
    with pytest.raises(SettingsError, match=r"loss is 1\.5"):
        compare([trial()], [codec], loss=(0.0, 1.5))
    with pytest.raises(SettingsError, match="jobs is 0"):
        compare([trial()], [codec], jobs=0)
    with pytest.raises(SampleError, match="sine, sample 3"):
        Trial(name="sine", t_us=np.arange(5), stimuli=np.array([[0.0], [1.0], [2.0], [np.nan], [1.0]]))
