from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.calibration import Calibration
from hapticnet.device.profile import (
    MeasuredCalibration,
    MeasuredFinger,
    Profile,
    dump_profile,
    load_profile,
    parse_profile,
)
from hapticnet.device.simulated import Sensor
from hapticnet.errors import FileError, SettingsError

WHOLE = """
serial = "A9B0C1D2"
servo_lag_s = 0.031

[calibration]
date = "2026-05-04"
residual_rms_n = 0.03
pairs = 16
counts = [178, 354.5, 552]
forces_n = [0.2, 0.5, 1]

[finger]
date = "2026-05-04"
stiffness_n_m = 900
contact_m = 0.0021
"""

days = st.dates().map(lambda day: day.isoformat())


@st.composite
def calibrations(draw):
    size = draw(st.integers(2, 20))
    columns = [sorted(draw(st.lists(st.floats(1e-300, 1e6), min_size=size, max_size=size, unique=True))) for _ in "cf"]
    return MeasuredCalibration(
        date=draw(days),
        residual_rms_n=draw(st.floats(0.0, 100.0)),
        pairs=draw(st.integers(2, 10**9)),
        counts=columns[0],
        forces_n=columns[1],
    )


profiles = st.builds(
    Profile,
    serial=st.text(max_size=200).filter(str.isprintable),
    calibration=st.none() | calibrations(),
    finger=st.none()
    | st.builds(MeasuredFinger, stiffness_n_m=st.floats(1.0, 1e5), contact_m=st.floats(0.0, 0.05), date=days),
    servo_lag_s=st.none() | st.floats(1e-4, 1.0),
)


@given(profiles)
def test_a_dumped_profile_is_loaded_identically(profile):
    assert parse_profile(dump_profile(profile), "device.toml") == profile


def test_all_tables_of_a_profile_are_optional(tmp_path: Path):
    path = tmp_path / "device.toml"
    path.write_text(WHOLE)
    profile = load_profile(path)
    assert (profile.serial, profile.servo_lag_s, profile.is_generic) == ("A9B0C1D2", 0.031, False)
    assert profile.table == Calibration((178.0, 354.5, 552.0), (0.2, 0.5, 1.0))
    measured = profile.calibration
    assert measured is not None
    assert (measured.date, measured.pairs, measured.residual_rms_n) == ("2026-05-04", 16, 0.03)
    assert profile.finger == MeasuredFinger(stiffness_n_m=900.0, contact_m=0.0021, date="2026-05-04")
    path.write_text("")
    assert load_profile(path) == Profile()
    assert parse_profile(WHOLE.replace('"2026-05-04"', "2026-05-04"), "unquoted.toml") == profile


def test_an_uncalibrated_device_has_the_data_sheets_curve_and_is_generic():
    profile = Profile()
    assert profile.is_generic
    for force_n in (0.2, 1.0, 2.0, 5.0, 20.0):
        assert profile.table.force_n(Sensor().counts(force_n)) == pytest.approx(force_n, rel=1e-12)
    tuned = Profile(finger=MeasuredFinger(stiffness_n_m=900.0, contact_m=0.002, date="2026-05-04"))
    assert parse_profile(dump_profile(tuned), "device.toml").is_generic


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("servo_lag_s", "servo_lag"), "unknown key 'servo_lag' .*; the keys are serial, servo_lag_s, calibration"),
        (("contact_m", "contact"), "unknown key 'finger.contact' .*; the keys are stiffness_n_m, contact_m"),
        (("pairs = 16", ""), "calibration.pairs is missing"),
        (("pairs = 16", "pairs = 1.5"), r"calibration.pairs is 1.5; it must be a whole number"),
        (("[178,", "[178, 'x',"), r"calibration.counts.1 is 'x'; it must be a number"),
        (("[178,", "[900,"), r"counts go from 900 to 354.5; they must be"),
        (("0.031", "nan"), r"servo lag is nan s; it must be between"),
        (("900", "0"), r"finger stiffness is 0.0 N/m; it must be between 1 and"),
        (("2026-05-04", "yesterday"), r"calibration.date is 'yesterday'; it must be a date such as 2026-05-04"),
        (('"A9B0C1D2"', "7"), r"serial is 7; it must be text in quotes"),
        (('"A9B0C1D2"', '"a\\nb"'), r"serial is 'a\\nb'; it must be at most 200 printable"),
        (("[finger]", "[[finger]]"), r"finger is \[.*\]; it must be a table"),
    ],
)
def test_mistakes_are_reported_with_their_key(tmp_path: Path, change, message):
    path = tmp_path / "device.toml"
    path.write_text(WHOLE.replace(*change, 1))
    with pytest.raises(SettingsError, match=message) as raised:
        load_profile(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


def test_files_that_are_not_profiles_are_refused(tmp_path: Path):
    path = tmp_path / "device.toml"
    with pytest.raises(FileError, match="No such file"):
        load_profile(path)
    path.write_text("serial = ")
    with pytest.raises(FileError, match="not a TOML file: "):
        load_profile(path)
    path.write_bytes(b"serial = '\xff'")
    with pytest.raises(FileError, match="not UTF-8 text: byte 10 is 0xff"):
        load_profile(path)
