"""What a recording is read as: columns, units, times, missing values, and what the user is told."""

import os
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import FileError, SettingsError
from hapticnet.recordings.loading import load_motion, load_recording

MISSING = "t_s,f,x\n0,,1\n0.001,2,\n0.002,3,nan\n,4,4\n0.004,5,NA\n0.005,6,6\n"


@pytest.fixture
def file(tmp_path):
    def write(content, name="r.csv"):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.fixture
def three(file):
    return file("t_s,fx,fy\n0.0,1,4\n0.001,2,5\n0.0025,3,6\n")


def test_a_recording_is_frozen_and_in_si_units(file):
    recording = load_recording(file("t_ms,F [mN],x_mm\n1,2000,3\n2,-4000,5\n"), columns="F", position="x")
    assert recording.t_us.tolist() == [1000, 2000]
    assert recording.t_us.dtype == np.int64
    assert recording.force.tolist() == [[2.0], [-4.0]]
    assert recording.position.tolist() == [[0.003], [0.005]]
    assert recording.names == ("F [mN]",)
    with pytest.raises(FrozenInstanceError):
        recording.names = ()


def test_columns_are_chosen_by_name_number_or_list(three):
    for columns in (["fx", "fy"], "1,2", " fx , 2"):
        assert load_recording(three, columns=columns).force.tolist() == [[1, 4], [2, 5], [3, 6]]
    assert load_recording(str(three), columns="fy").position is None


def test_the_only_column_that_is_not_time_needs_no_name(file):
    recording = load_recording(file("t_us,force\n5,1\n7,2\n"))
    assert (recording.names, recording.t_us.tolist(), recording.force[:, 0].tolist()) == (("force",), [5, 7], [1, 2])
    assert load_recording(file(",t_us,force\n0,5,1\n1,7,2\n")).names == ("force",), "an index column has no name"
    with pytest.raises(FileError, match=r"which column\? there are t_s, fx, fy"):
        load_recording(file("t_s,fx,fy\n0,1,2\n"))


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("x", 1.0), ("x_m", 1.0), ("x [mm]", 1e-3), ("x (mm)", 1e-3), ("x[mm]", 1e-3), ("x_mm", 1e-3), ("x mm", 1e-3),
        ("x / mm", 1e-3), ("x [MM]", 1e-3), ("x_um", 1e-6), ("x [µm]", 1e-6), ("x [\N{GREEK SMALL LETTER MU}m]", 1e-6),
        ("x_cm", 1e-2), ("x [in]", 0.0254), ("x_left", 1.0), ("x.mm", 1.0),
    ],
)  # fmt: skip
def test_units_of_position_are_obeyed_and_told(file, header, scale):
    path = file(f"t_s,f,{header}\n0,1,2\n0.001,2,3\n")
    recording = load_recording(path, columns="f", position=header)
    assert recording.position[:, 0] == pytest.approx([2 * scale, 3 * scale], rel=1e-15)
    told = [note for note in recording.notes if "scaled" in note]
    assert len(told) == (scale != 1.0)
    assert load_recording(path, columns="f", position=header, position_scale=-2.0).position.tolist() == [[-4.0], [-6.0]]


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("F_N", 1.0), ("force_n", 1.0), ("Fx (mN)", 1e-3), ("F_mN", 1e-3), ("F [kN]", 1e3), ("F [gf]", 9.80665e-3),
        ("F [V]", None), ("F [MN]", None), ("torque_Nm", None), ("F (left)", None),
    ],
)  # fmt: skip
def test_units_of_force_are_obeyed_and_others_told(file, header, scale):
    recording = load_recording(file(f"t_s,{header}\n0,1\n0.001,2\n"))
    assert recording.force[:, 0] == pytest.approx([scale or 1.0, 2 * (scale or 1.0)], rel=1e-15)
    assert any("values are taken as N" in note for note in recording.notes) == (scale is None)


@pytest.mark.parametrize(
    "content", ["t\tF\n[ms]\t[mN]\n0\t1\n1\t2\n", "t   [ms] F  (mN)\n0 1\n1 2\n", "t_ms\t F_mN\n0 1\n1 2\n"]
)
def test_units_stand_under_the_header_or_beside_a_name_after_white_space(file, content):
    recording = load_recording(file(content))
    assert (recording.t_us.tolist(), recording.force[:, 0].tolist()) == ([0, 1000], [0.001, 0.002])


@pytest.mark.parametrize(
    ("header", "first", "second"),
    [
        ("t_us", "5", "1005"), ("t_ms", "0.005", "1.005"), ("t_s", "5e-6", "0.001005"), ("time_s", "5e-6", "0.001005"),
        ("Time [ms]", "0.005", "1.005"), ("timestamp_ns", "5000", "1005000"), ("TIME (s)", "5e-6", "0.001005"),
        ("time/us", "5", "1005"), ("data.t_us", "5", "1005"), ("timestamp,t_us", "1700000000,5", "1700000001,1005"),
    ],
)  # fmt: skip
def test_times_are_read_in_the_unit_of_their_column(file, header, first, second):
    recording = load_recording(file(f"{header},f\n{first},1\n{second},2\n"), columns="f")
    assert recording.t_us.tolist() == [5, 1005]
    assert recording.notes == ()


@pytest.mark.parametrize(
    ("header", "time", "step_us"),
    [("Zeit [s]", "Zeit [s]", 10), ("Zeit [ms]", "Zeit", 0), ("X_Value", "X_Value", 10), ("X_Value", "0", 10)],
)
def test_a_column_of_any_name_can_have_the_times(file, header, time, step_us):
    path = file(f"{header},F\n0,1\n0.00001,2\n0.00002,3\n")
    with pytest.raises(FileError, match=r"which column\?"):
        load_recording(path)
    recording = load_recording(path, time=time)
    assert np.diff(recording.t_us).tolist() == [step_us, step_us]
    assert recording.names == ("F",)
    assert load_motion(path, time=time).position[:, 0].tolist() == [1.0, 2.0, 3.0]


def test_a_text_that_is_not_utf_8_is_latin_1_wherever_that_shows(file):
    path = file("t_s;f [µN];Ort\n".encode("latin-1") + b"0;1;x\n" * 1000 + "0;2;Gerät\n".encode("latin-1"))
    recording = load_recording(path, columns="f")
    assert recording.force[-1, 0] == pytest.approx(2e-6)
    assert "the text is not UTF-8; it is read as Latin-1" in recording.notes
    late = file(b"t_s,f,Ort\n" + b"0,1,x\n" * 300_000 + "0,2,Gerät\n".encode("latin-1"), "late.csv")
    assert load_recording(late, columns="f").force[-1, 0] == 2.0


def test_columns_that_are_chosen_by_their_names_are_told(file):
    path = file("t_s,force_x,force_y,force_z,x\n0,1,2,3,4\n0.001,2,3,4,5\n")
    assert "force: force_x, force_y, force_z, chosen by their names" in load_recording(path).notes
    assert load_recording(path, columns="force_x").notes == ()
    assert "position: pos_x, chosen by its name" in load_motion(file("t_s,pos_x,f\n0,1,2\n1e-3,2,3\n", "m.csv")).notes


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"columns": "fx", "position": "fx"}, "taken as force and as position"),
        ({"columns": "fx,fx"}, "taken as force twice"),
        ({"columns": "fx", "position": "t_s"}, "taken as time and as position"),
        ({"columns": "1,fy", "time": "fx"}, "taken as time and as force"),
    ],
)
def test_a_column_is_one_thing_once(three, arguments, words):
    with pytest.raises(SettingsError, match=words):
        load_recording(three, **arguments)


@pytest.mark.parametrize("name", ["timestamp", "t", "Time Stamp"])
@pytest.mark.parametrize(
    ("unit", "word"), [(1e6, "seconds"), (1e3, "milliseconds"), (1.0, "microseconds"), (1e-3, "nanoseconds")]
)
@pytest.mark.parametrize("epoch_s", [0, 1_700_000_000])
def test_times_without_a_unit_are_read_by_their_size_which_is_told(file, name, unit, word, epoch_s):
    expected = epoch_s * 1_000_000 + 1000 * np.arange(5)
    rows = "".join(f"{t_us / unit!r},1\n" for t_us in expected.tolist())
    recording = load_recording(file(f"{name},f\n{rows}"))
    assert np.abs(recording.t_us - expected).max() <= (1 if epoch_s else 0)
    assert len(recording.notes) == 1
    assert f"read as {word}" in recording.notes[0]
    assert ("since 1970" in recording.notes[0]) == bool(epoch_s)


@pytest.mark.parametrize(
    ("stamps", "step_us"),
    [
        (("2026-01-01T00:00:00", "2026-01-01T00:00:00.001"), 1000),
        (("2026-01-01 00:00:00.5Z", "2026-01-01 01:00:00.501+01:00"), 1000),
        (("2026-01-01T00:00:00.000001", "2026-01-01T00:00:00.000002"), 1),
        (("20260101T000000", "20260101T000001"), 1_000_000),
    ],
)
def test_stamps_in_iso_8601_are_read(file, stamps, step_us):
    rows = "{},1\n{},2\n".format(*stamps)
    recording = load_recording(file(f"timestamp,f\n{rows}"))
    assert np.diff(recording.t_us).tolist() == [step_us]
    assert recording.t_us[0] // 10**9 == 1_767_225
    bare = load_recording(file(rows), columns="1", rate_hz=1000.0)
    assert bare.t_us.tolist() == [0, 1000], "stamps make no header"


def test_the_rate_applies_to_files_without_times_only_and_that_is_told(file, three):
    assert load_recording(file("f\n1\n2\n3\n", "f.csv"), rate_hz=500.0).t_us.tolist() == [0, 2000, 4000]
    called_t = load_recording(file("T,x\n5,1\n4,2\n", "T.csv"), columns="T", rate_hz=1000.0)
    assert (called_t.force[:, 0].tolist(), called_t.t_us.tolist()) == ([5.0, 4.0], [0, 1000])
    recording = load_recording(three, columns="fx", rate_hz=500.0)
    assert recording.t_us.tolist() == [0, 1000, 2500]
    assert any('"t_s" has the times; --sampling-rate 500 is not used' in note for note in recording.notes)
    with pytest.raises(FileError, match=r"no column is called t, time or timestamp .* --sampling-rate"):
        load_recording(file("f\n1\n2\n", "f.csv"))


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, 5e-324, 1e-4, 1e7, float("inf"), float("nan")])
def test_rates_that_microseconds_cannot_express_are_refused(three, rate_hz):
    with pytest.raises(SettingsError, match=r"rate is .* must be between 0\.001 and 1e\+06 Hz"):
        load_recording(three, columns="fx", rate_hz=rate_hz)


@pytest.mark.parametrize(
    ("content", "arguments", "error", "message"),
    [
        ("t_s,f\n0,1\n1e300,2\n", {}, FileError, "the limit is"),
        ("t_s,f\n0,1\n0.002,1\n0.001,2\n", {}, FileError, r"backwards 1 times, first at sample 2 from 0\.002000 s to"),
        ("t_s,f\n0,1\n", {"missing": "guess"}, SettingsError, "missing is 'guess'; it must be refuse, drop or hold"),
        ("t_s,f,x,y\n0,1,2,3\n", {"columns": "f", "position": "x,y"}, SettingsError, "2 position columns for 1 force"),
        ("t_s,f\n0,1\n", {"position_scale": 2.0}, SettingsError, r"--position-column, which is not given \(posi"),
        ("t_s,f,x\n0,1,2\n", {"columns": "f", "position": "x", "position_scale": 0.0}, SettingsError, "position-scale"),
        ("t_s,a,b,c,d\n0,1,2,3,4\n", {"columns": "a,b,c,d"}, SettingsError, "4 force columns are chosen"),
        ("t_s,f\n0,1\n", {"columns": ""}, FileError, 'no column ""'),
        ("t_s,f\n,1\n", {"missing": "drop"}, FileError, "every row lacks a value"),
        ("t_s,f\n0,1\n", {"max_bytes": 5}, FileError, "10 bytes; the limit is 5"),
        ("time [min],f\n0,1\n1,2\n", {}, FileError, r'"time \[min\]": "min" is not a known unit of time; known are'),
        ("time,f\n2026-01-01T01,1\nyesterday,2\n", {}, FileError, 'line 3, column "time": "yesterday" is not a date'),
        (MISSING, {"columns": "f,x"}, FileError, 'line 2, column "f": no number; 5 of 6 rows lack one; use --missing'),
    ],
)
def test_what_cannot_be_read_is_refused(file, content, arguments, error, message):
    with pytest.raises(error, match=message):
        load_recording(file(content), **arguments)


def test_rows_with_missing_values_are_dropped_or_hold_the_last_value_and_are_counted(file):
    dropped = load_recording(file(MISSING), columns="f", position="x", missing="drop")
    assert (dropped.t_us.tolist(), dropped.force.tolist(), dropped.position.tolist()) == ([5000], [[6]], [[6]])
    assert "5 of 6 rows with missing values are left out" in dropped.notes
    held = load_recording(file(MISSING), columns="f", position="x", missing="hold")
    assert held.t_us.tolist() == [1000, 2000, 4000, 5000]
    assert held.force[:, 0].tolist() == [2, 3, 5, 6]
    assert held.position[:, 0].tolist() == [1, 1, 4, 6]
    assert any("5 of 6 rows" in note and "2 rows without a time or an earlier value" in note for note in held.notes)


def test_dropped_rows_leave_a_gap_where_the_rate_gives_the_times(file):
    recording = load_recording(file("f,g\n1,\n,\n3,\n4,\n"), columns="f", rate_hz=1000.0, missing="drop")
    assert recording.t_us.tolist() == [0, 2000, 3000]
    times_of_day = file("time,f\n,0\n00:00:01.5,1\n00:01:00,2\n")
    assert load_recording(times_of_day, missing="drop").t_us.tolist() == [1_500_000, 60_000_000]


def test_gaps_repeated_stamps_and_peaks_are_told(file):
    t_us = np.arange(2000) * 1000
    t_us[500:] += 20_000
    t_us[700] = t_us[699]
    force = np.sin(np.arange(2000) / 100)
    force[1234] = 5e5
    rows = "".join(f"{t},{f}\n" for t, f in zip(t_us, force, strict=True))
    gap, repeated, peak = sorted(load_recording(file("t_us,f\n" + rows)).notes, key=lambda note: "gap" not in note)
    assert gap == "1 gap in time (more than 5 times the median step of 1 ms), the longest 0.021 s after sample 499"
    assert repeated == "1 of 2000 samples repeat the time stamp of the sample before"
    assert peak.startswith(
        "force: 1 sample is far outside the rest, up to 500000 N at sample 1234; the rest is between -"
    )


@given(st.integers(0, 2**32 - 1))
def test_a_smooth_force_and_long_contacts_have_no_notes(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    force = np.zeros(3000)
    start, length = rng.integers(0, 2500), rng.integers(10, 500)
    force[start : start + length] = rng.uniform(0.1, 10.0) * np.sin(np.linspace(0, np.pi, length))
    path = tmp_path_factory.getbasetemp() / "smooth.npy"
    np.save(path, force + 0.001 * rng.standard_normal(3000))
    assert load_recording(path, rate_hz=1000.0).notes == ()


@given(
    values=st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=50),
    start=st.integers(-(10**9), 10**12),
    unit=st.sampled_from(["s", "ms", "us"]),
)
def test_what_is_written_is_read_back(tmp_path_factory, values, start, unit):
    t_us = start + 1000 * np.arange(len(values))
    size = {"s": 10**6, "ms": 10**3, "us": 1}[unit]
    path = tmp_path_factory.getbasetemp() / "back.csv"
    rows = (f"{t // size}.{t % size:0{len(str(size)) - 1}d}" if size > 1 else f"{t}" for t in (t_us - start).tolist())
    path.write_text(f"t [{unit}];f\n" + "".join(f"{t};{v!r}\n" for t, v in zip(rows, values, strict=True)))
    recording = load_recording(path)
    assert recording.t_us.tolist() == (t_us - start).tolist()
    assert recording.force[:, 0].tolist() == values


def test_positions_are_found_by_their_name(file):
    assert load_motion(file("t_us,position_m,force_n\n0,1,9\n5,2,9\n")).position.tolist() == [[1], [2]]
    assert load_motion(file("t_us,pos_x [mm],pos_y [mm],f\n0,1,2,9\n")).position.tolist() == [[0.001, 0.002]]
    assert load_motion(file("t_us,x\n0,1\n")).position.tolist() == [[1]]
    with pytest.raises(FileError, match="which column"):
        load_motion(file("t_us,x,y\n0,1,2\n"))


def test_positions_of_a_force_are_found_by_their_name(file):
    found = load_recording(file("t_us,position_m,force_n\n0,1,9\n5,2,9\n"))
    assert found.position.tolist() == [[1], [2]]
    assert "position: position_m, chosen by its name" in found.notes
    other_axes = load_recording(file("t_us,pos_x,pos_y,force_n\n0,1,2,9\n"))
    assert other_axes.position is None
    gap = load_recording(file("t_us,position_m,force_n\n0,1,9\n5,,9\n"))
    assert gap.position is None
    assert gap.force.tolist() == [[9], [9]]
    assert "position: position_m lack values and are not used" in gap.notes
    with pytest.raises(SettingsError, match="no column is called position"):
        load_recording(file("t_us,force\n0,1\n"), position_scale=2.0)


@pytest.mark.parametrize("load", [load_recording, load_motion])
@pytest.mark.parametrize("name", ["a.csv", "a.npy", "a.npz", "a.mat"])
def test_devices_and_pipes_are_refused_without_opening_them(tmp_path, name, load):
    (tmp_path / "zero").mkdir()
    endless = tmp_path / "zero" / name
    endless.symlink_to("/dev/zero")
    with pytest.raises(FileError, match="is a character device; expected a regular file"):
        load(endless)
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileError, match="is a pipe; expected a regular file"):
        load(tmp_path / name)


@pytest.mark.parametrize(
    "header", ["a" + " " * 100_000 + "b", "(" * 100_000, "a_" * 50_000, "\t" * 100_000, "9" * 100_000]
)
@pytest.mark.timeout(10)
def test_hostile_headers_take_no_longer_than_others(file, header):
    with pytest.raises(FileError) as caught:
        load_recording(file(f"{header}\n0\n1\n"))
    assert len(str(caught.value)) < 3000


def test_control_characters_do_not_reach_the_terminal(file):
    path = file("t_s,f\x1b[31m,\x9b2J\n0,1,\x1b[2Jx\n")
    recording = load_recording(path, columns="1")
    assert " ".join([*recording.names, *recording.notes]).isprintable()
    for columns in ("2", "none"):
        with pytest.raises(FileError) as refused:
            load_recording(path, columns=columns)
        assert str(refused.value).isprintable()
