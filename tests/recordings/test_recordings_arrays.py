"""Arrays from NumPy and MATLAB files, and what any other or damaged file is told to be."""

import io
import sys
import zipfile

import numpy as np
import pytest
import scipy.io

from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.recordings import columns as columns_module
from hapticnet.recordings.loading import load_motion, load_recording

T_US = np.arange(6) * 1000
FORCE = np.arange(18.0).reshape(6, 3)


@pytest.mark.parametrize(
    ("array", "columns", "expected"),
    [
        (np.array([1.0, 2.0]), None, [[1], [2]]),
        (np.array([[1, 2], [3, 4]], dtype=np.int16), "1", [[2], [4]]),
        (np.array([(1.0, 2.0)], dtype=[("fx", "f4"), ("fy", "f8")]), "fy,fx", [[2, 1]]),
        (np.asfortranarray([[1.0, 2.0], [3.0, 4.0]]), "0,1", [[1, 2], [3, 4]]),
        (np.array([True, False]), None, [[1], [0]]),
        (np.array([(5.0, 2000.0), (6.0, 3000.0)], dtype=[("t_ms", "f8"), ("F [mN]", "f8")]), None, [[2], [3]]),
    ],
)
def test_npy_of_one_or_two_dimensions_or_structured(tmp_path, array, columns, expected):
    np.save(tmp_path / "a.npy", array)
    recording = load_recording(tmp_path / "a.npy", columns=columns, rate_hz=1000.0)
    assert recording.force.tolist() == expected
    assert recording.t_us.tolist() == [5000, 6000] if "t_ms" in (array.dtype.names or ()) else [0, 1000][: len(array)]


@pytest.mark.parametrize(
    ("array", "columns", "complaint"),
    [
        (np.zeros((2, 2, 2)), ["0"], r"array of shape \(2, 2, 2\)"),
        (np.zeros(0), None, "no samples"),
        (np.float64(1.0), None, "shape"),
        (np.zeros((3, 2)), None, "which column"),
        (np.array(["a", "b"]), None, "holds <U1; expected real numbers"),
        (np.array([1 + 2j]), None, "expected real numbers"),
        (np.array([1.0, np.inf]), None, 'row 1, column "0": inf is not a finite number'),
        (np.array([1.0, np.nan]), None, 'row 1, column "0": no number; 1 of 2 rows'),
        (np.array([(1, (1, 2))], dtype=[("a", "f8"), ("b", "f8", 2)]), ["b"], r"shape \(1, 2\)"),
    ],
)
def test_npy_that_is_not_a_signal_is_refused(tmp_path, array, columns, complaint):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(FileError, match=complaint):
        load_recording(tmp_path / "a.npy", columns=columns, rate_hz=1000.0)


def save_npz(path, arrays):
    np.savez_compressed(path, **arrays)


def save_mat(path, arrays):
    scipy.io.savemat(path, arrays, do_compression=True)


@pytest.mark.parametrize("save", [save_npz, save_mat])
def test_arrays_by_name(tmp_path, save):
    path = tmp_path / ("a.npz" if save is save_npz else "a.mat")
    save(path, {"t_us": T_US, "force": FORCE, "x_mm": FORCE[:, :1], "wide": FORCE.T, "fs": np.array(1000.0)})
    path = path.rename(tmp_path / "a.csv")  # its content counts, not its name
    for columns in ("force", "wide", "force.0,force.1,wide.2"):
        recording = load_recording(path, columns=columns)
        assert recording.t_us.tolist() == T_US.tolist()
        assert recording.force.tolist() == FORCE.tolist()
    assert load_recording(path, columns="force.0", position="x").position[:, 0] == pytest.approx(FORCE[:, 0] / 1000)
    with pytest.raises(FileError, match=r'no column "fs"; there are t_us, force\.0'):
        load_recording(path, columns="fs")
    with pytest.raises(SettingsError, match="1 position columns for 3 force columns"):
        load_recording(path, columns="force", position="x")


def test_mat_structures_motion_and_version_4(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"run": {"time": T_US / 1e6, "position": FORCE, "note": "pushing foam"}})
    assert load_motion(tmp_path / "a.mat").t_us.tolist() == T_US.tolist()
    assert load_recording(tmp_path / "a.mat", columns="run.position.1").force[:, 0].tolist() == FORCE[:, 1].tolist()
    scipy.io.savemat(tmp_path / "a.mat", {"t_us": T_US.astype(float), "f": FORCE[:, 0]}, format="4")
    assert load_recording(tmp_path / "a.mat").force[:, 0].tolist() == FORCE[:, 0].tolist()


def test_what_unpacks_to_more_than_the_limit_is_refused_before_it_is_unpacked(tmp_path):
    zeros = np.zeros(200_000)
    save_npz(tmp_path / "a.npz", {"f": zeros})
    save_mat(tmp_path / "a.mat", {"f": zeros})
    for name in ("a.npz", "a.mat"):
        assert (tmp_path / name).stat().st_size < 100_000
        with pytest.raises(FileError, match=r"unpacks to 1600[0-9]{3} bytes; the limit is 1000000"):
            load_recording(tmp_path / name, rate_hz=1000.0, max_bytes=1_000_000)


def test_fields_of_mat_structures_count_for_the_limit(tmp_path):
    for packed in (True, False):
        scipy.io.savemat(tmp_path / "a.mat", {"s": {"a": {"f": np.zeros(200_000)}}, "t": 1.0}, do_compression=packed)
        with pytest.raises(FileError, match=r"unpacks to more than 1000000 bytes|1600[0-9]{3} bytes; the limit"):
            load_recording(tmp_path / "a.mat", rate_hz=1000.0, max_bytes=1_000_000)
        assert len(load_recording(tmp_path / "a.mat", rate_hz=1000.0, columns="s.a.f").force) == 200_000


def test_an_npy_header_that_claims_more_than_the_limit_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(9))
    content = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(content.replace(b"(9,), }        ", b"(99999999999,)}"))
    with pytest.raises(FileError, match="an array of 799999999992 bytes; the limit is 2147483648"):
        load_recording(tmp_path / "a.npy", rate_hz=1000.0)


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    save_mat(tmp_path / "a.mat", {"f": FORCE})
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(UnavailableError, match=r"pip install scipy"):
        load_recording(tmp_path / "a.mat", rate_hz=1000.0)


def zipped(name):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, "x")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n", r"a MATLAB v7\.3 file \(HDF5\); save it with '-v7'"),
        (b"\x89HDF\r\n\x1a\n\0\0", "an HDF5 file"),
        (b"\x89MCAP0\r\n\0\0", "an MCAP file, but not a recording of hapticnet: it has no topics"),
        (b"#ROSBAG V2.0\n\0\0", "a ROS bag"),
        (b"SQLite format 3\0", "an SQLite database, such as a ROS 2 bag"),
        (b"PAR1\x15\x04", "a Parquet file; save it as CSV or .npz"),
        (b"\x1f\x8b\x08\0", "a compressed file; unpack it first"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "a Microsoft Office file"),
        (zipped("xl/workbook.xml"), "an Excel workbook; save it as CSV"),
        (zipped("force.csv"), "a zip archive without NumPy arrays; unpack it first"),
        (b"PK\x03\x04 cut off", "a damaged zip archive"),
        (np.arange(1000, dtype=np.int16).tobytes(), "a binary file of an unknown kind; CSV, TSV, .npy"),
        (np.random.default_rng(1).bytes(5000), "a binary file of an unknown kind"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["a.csv", "a", "a.npy"])
def test_other_files_are_named_for_what_they_are(tmp_path, content, kind, name):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError, match="not a .npy file" if name == "a.npy" and "unknown kind" in kind else kind):
        load_recording(tmp_path / name, rate_hz=1000.0)


@pytest.mark.filterwarnings("ignore")  # SciPy and NumPy warn of what they then raise for
@pytest.mark.parametrize("name", ["a.csv", "b.csv", "a.npy", "a.npz", "a.mat"])
def test_mutated_files_are_read_or_refused(tmp_path, name):
    rng = np.random.default_rng(sum(name.encode()))
    path = tmp_path / name
    columns = {"t_us": T_US, "f": FORCE[:, 0], "x_mm": FORCE[:, 1]}
    rows = list(zip(*columns.values(), strict=True))
    if name == "a.csv":
        path.write_text("t_us,f,x_mm\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    elif name == "b.csv":
        path.write_text("# t [ms];f [mN]\n" + "".join(f'{a},5;"{b}"\n' for a, b, _ in rows))
    elif name == "a.npy":
        np.save(path, np.array(rows, dtype=[("t_us", "i8"), ("f", "f8"), ("x_mm", "f4")]))
    else:
        {"a.npz": save_npz, "a.mat": save_mat}[name](path, columns)
    whole = path.read_bytes()
    refused = 0
    for _ in range(400):
        content = bytearray(whole)
        for _ in range(rng.integers(1, 4)):
            at, count = int(rng.integers(len(content))), int(rng.integers(20))
            other = (bytes([content[at] ^ 1 << count % 8]), rng.bytes(1), b"", content[:count])[rng.integers(4)]
            content[at : at + (count if not other else 1)] = other
        path.write_bytes(content)
        try:
            recording = load_recording(path, columns="f", rate_hz=1000.0, missing="drop", max_bytes=10_000_000)
        except (FileError, SettingsError):
            refused += 1
        else:
            assert np.isfinite(recording.force).all()
            assert recording.force.shape == (len(recording.t_us), 1)
    assert refused > 20


def test_arrays_of_bytes_are_limited_by_their_size_as_numbers_alone_and_together(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", force=np.ones((1000, 2), dtype=np.uint8))
    np.save(tmp_path / "a.npy", np.ones((1000, 2), dtype=np.uint8))
    for name, columns in (("a.npz", None), ("a.npy", "0,1")):
        read = {"columns": columns, "rate_hz": 1000.0}
        assert len(load_recording(tmp_path / name, max_bytes=16_000, **read).force) == 1000
        with pytest.raises(FileError, match="an array of 16000 bytes; the limit is 15999"):
            load_recording(tmp_path / name, max_bytes=15_999, **read)
    np.savez_compressed(tmp_path / "a.npz", **{f"a{index}": np.ones(1000, dtype=np.uint8) for index in range(3)})
    with pytest.raises(FileError, match="unpacks to more than 20000 bytes"):
        load_recording(tmp_path / "a.npz", rate_hz=1000.0, max_bytes=20_000)


def test_more_columns_than_the_limit_are_refused_in_words(tmp_path, monkeypatch):
    monkeypatch.setattr(columns_module, "MOST_COLUMNS", 5)
    numbers = np.ones((10, 6))
    np.save(tmp_path / "wide.npy", numbers)
    np.savez(tmp_path / "wide.npz", force=numbers)
    np.savez(tmp_path / "many.npz", **{f"a{index}": np.ones(10) for index in range(6)})
    scipy.io.savemat(tmp_path / "wide.mat", {"force": numbers})
    np.savetxt(tmp_path / "wide.csv", numbers, delimiter=",")
    np.savetxt(tmp_path / "wide.txt", numbers)
    (tmp_path / "last.csv").write_text("a,b\n1,2\n3,4,5,6,7,8\n")
    for file in sorted(tmp_path.iterdir()):
        with pytest.raises(FileError, match="6 columns; the limit is 5"):
            load_recording(file, rate_hz=1000.0)
