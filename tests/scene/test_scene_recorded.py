import numpy as np
import pytest

from hapticnet.errors import FileError
from hapticnet.recordings.text import write_csv
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.recorded import RecordedScene
from hapticnet.scene.sources import RecordedSource, find_source

T_US = np.array([5000, 6000, 8000])
FORCE_N = np.array([[1.0, 0.0], [2.0, -1.0], [3.0, 0.5]])


@pytest.mark.parametrize(
    ("since_us", "force_n"),
    [
        (0, (1.0, 0.0)),
        (999, (1.0, 0.0)),
        (1000, (2.0, -1.0)),
        (2999, (2.0, -1.0)),
        (3000, (3.0, 0.5)),
        (3001, (0.0, 0.0)),
    ],
)
def test_the_force_passes_in_time_from_the_first_position_on(since_us, force_n):
    scene = RecordedScene(T_US, FORCE_N, name="it")
    assert scene.step(PositionSample(7_000_000, (0.0, 0.0))) == ForceSample(7_000_000, (1.0, 0.0))
    assert scene.step(PositionSample(7_000_000 + since_us, (0.1, 0.2))) == ForceSample(7_000_000 + since_us, force_n)


def test_each_master_feels_it_from_the_beginning(tmp_path):
    write_csv(tmp_path / "a.csv", {"t_us": T_US, "force_n": FORCE_N[:, 0]})
    source = find_source(f"recording:{tmp_path}/a.csv")
    source.prepare()
    first, second = source.make(), source.make()
    first.step(PositionSample(0, (0.0,)))
    assert first.step(PositionSample(1000, (0.0,))).force_n == (2.0,)
    assert second.step(PositionSample(1000, (0.0,))).force_n == (1.0,)
    assert (source.name, first.name, first.axes) == ("recording:a.csv", "recording:a.csv", 1)


def test_columns_can_be_chosen_and_a_name_may_have_a_colon(tmp_path):
    write_csv(tmp_path / "a:b.csv", {"t_us": T_US, "fx": FORCE_N[:, 0], "fy": FORCE_N[:, 1]})
    scene = find_source(f"recording:{tmp_path}/a:b.csv:fy").make()
    assert scene.step(PositionSample(0, (0.0,))).force_n == (0.0,)
    with pytest.raises(FileError, match="which column"):
        find_source(f"recording:{tmp_path}/a:b.csv")


def test_a_force_out_of_range_is_refused(tmp_path):
    write_csv(tmp_path / "a.csv", {"t_us": [0, 1], "force_n": [1e16, 0.0]})
    with pytest.raises(FileError, match=r"sample 0 is 1e\+16 N"):
        RecordedSource(tmp_path / "a.csv")
