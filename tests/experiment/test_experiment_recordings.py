import numpy as np
import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.experiment.recordings import load_recording


@pytest.fixture
def csv(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("t_s,fx,fy\n0.0,1,4\n0.001,2,5\n0.0025,3,6\n")
    return path


def test_time_comes_from_a_column_or_from_the_rate(csv):
    assert load_recording(csv, columns=["fx"]).t_us.tolist() == [0, 1000, 2500]
    np.save(csv.with_suffix(".npy"), np.arange(3.0))
    assert load_recording(csv.with_suffix(".npy"), rate_hz=500.0).t_us.tolist() == [0, 2000, 4000]
    with pytest.raises(SettingsError, match="t_s tells the time; leave --rate away"):
        load_recording(csv, columns=["fx"], rate_hz=500.0)


def test_columns_by_name_and_number(csv):
    assert load_recording(csv, columns=["fx", "fy"]).values.tolist() == [[1, 4], [2, 5], [3, 6]]
    assert load_recording(csv, columns=["2"]).values.tolist() == [[4], [5], [6]]


def test_the_only_column_that_is_not_time_needs_no_name(tmp_path):
    path = tmp_path / "one.csv"
    path.write_text("t_us,force\n5,1\n7,2\n")
    signal = load_recording(path)
    assert (signal.names, signal.t_us.tolist(), signal.values[:, 0].tolist()) == (("force",), [5, 7], [1, 2])


@pytest.mark.parametrize(
    ("array", "columns", "expected"),
    [
        (np.array([1.0, 2.0]), None, [[1], [2]]),
        (np.array([[1, 2], [3, 4]], dtype=np.int16), ["1"], [[2], [4]]),
        (np.array([(1.0, 2.0)], dtype=[("fx", "f4"), ("fy", "f8")]), ["fy", "fx"], [[2, 1]]),
    ],
)
def test_npy_of_one_or_two_dimensions_or_with_names(tmp_path, array, columns, expected):
    np.save(tmp_path / "a.npy", array)
    assert load_recording(tmp_path / "a.npy", columns=columns, rate_hz=1000.0).values.tolist() == expected


@pytest.mark.parametrize(
    ("array", "columns", "complaint"),
    [
        (np.zeros((2, 2, 2)), ["0"], "shape"),
        (np.zeros(0), None, "no samples"),
        (np.zeros((3, 2)), ["7"], "no column '7'; there are: 0, 1"),
        (np.zeros((3, 2)), None, "which column"),
        (np.array(["a", "b"]), None, "numbers are wanted"),
        (np.array([1 + 2j]), None, "numbers are wanted"),
        (np.array([1.0, np.inf]), None, "row 1, column '0': inf is not finite"),
    ],
)
def test_npy_that_cannot_be_a_signal_is_refused(tmp_path, array, columns, complaint):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(FileError, match=complaint):
        load_recording(tmp_path / "a.npy", columns=columns, rate_hz=1000.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e300])
def test_a_rate_that_cannot_be_is_refused(csv, rate):
    with pytest.raises(SettingsError, match="rate is"):
        load_recording(csv, columns=["fx"], rate_hz=rate)


def test_times_beyond_what_can_be_counted_are_refused(tmp_path):
    path = tmp_path / "late.csv"
    path.write_text("t_s,f\n0,1\n1e300,2\n")
    with pytest.raises(FileError, match="beyond what can be counted"):
        load_recording(path)


def test_an_npy_file_with_any_byte_wrong_is_read_or_refused(tmp_path):
    path = tmp_path / "r.npy"
    np.save(path, np.arange(4.0))
    whole = path.read_bytes()
    refused = 0
    for place in range(len(whole)):
        for flip in (0x01, 0x20, 0xFF):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
            try:
                load_recording(path, rate_hz=1000.0, columns=["0"])
            except FileError:
                refused += 1
    assert refused > 100


def test_an_archive_of_arrays_is_refused(tmp_path):
    np.savez(tmp_path / "r.npz", np.arange(4.0))
    (tmp_path / "r.npz").rename(tmp_path / "r.npy")
    with pytest.raises(FileError, match="archive of arrays"):
        load_recording(tmp_path / "r.npy", rate_hz=1000.0)


@pytest.mark.parametrize("rate_hz", [0.0, 5e-324, 1e-4, 1e7, float("inf"), float("nan")])
def test_rates_that_microseconds_cannot_tell_are_refused(csv, rate_hz):
    with pytest.raises(SettingsError, match=r"must be between 0\.001 and 1e\+06"):
        load_recording(csv, columns=["fx"], rate_hz=rate_hz)
