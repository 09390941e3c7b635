"""The profile of one device, stored as TOML: its calibration, the finger it was tuned on, its servos.

All keys are optional:

.. code-block:: toml

    serial = "A9B0C1D2"
    servo_lag_s = 0.031

    [calibration]
    date = "2026-05-04"
    residual_rms_n = 0.03
    pairs = 16
    counts = [178.0, 354.0, 552.0]
    forces_n = [0.2, 0.5, 1.0]

    [finger]
    date = "2026-05-04"
    stiffness_n_m = 900.0
    contact_m = 0.0021
"""

import dataclasses
import re
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import tomli_w
from pydantic import BaseModel, BeforeValidator

from hapticnet.checks import check_parameter
from hapticnet.device.calibration import Calibration
from hapticnet.device.parts import Sensor
from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import SettingsError

LONGEST_SERIAL: Final = 200

GENERIC_FORCES_N: Final = (0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Forces [N] of the generic curve's knots: the range of the FSR 400 series, denser where it is curved."""

GENERIC_CALIBRATION: Final = Calibration(
    tuple(Sensor().counts(force_n) for force_n in GENERIC_FORCES_N), GENERIC_FORCES_N
)
"""A typical FSR 408 with 10 kΩ, from its data sheet; sensors differ by about 6 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredCalibration:
    """A measured calibration.

    Attributes
    ----------
    calibration
        The table.
    date
        Day of the measurement, as YYYY-MM-DD.
    residual_rms_n
        Root mean square [N] of the residuals of the measured pairs.
    pairs
        Number of measured pairs.

    Raises
    ------
    SettingsError
        If a value is invalid.
    """

    calibration: Calibration
    date: str
    residual_rms_n: float
    pairs: int

    def __post_init__(self) -> None:
        _check_date("calibration date", self.date)
        check_parameter("calibration residual", self.residual_rms_n, 0.0, 100.0, "N")
        check_parameter("calibration pairs", self.pairs, 2, 1_000_000_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredFinger:
    """A finger as measured by the device.

    Attributes
    ----------
    stiffness_n_m
        Tangent stiffness [N/m] at 1 N.
    contact_m
        Platform displacement [m] at which it touches the finger.
    date
        Day of the measurement, as YYYY-MM-DD.

    Raises
    ------
    SettingsError
        If a value is invalid.
    """

    stiffness_n_m: float
    contact_m: float
    date: str

    def __post_init__(self) -> None:
        _check_date("finger date", self.date)
        check_parameter("finger stiffness", self.stiffness_n_m, 1.0, 1e5, "N/m")
        check_parameter("finger contact", self.contact_m, 0.0, 0.05, "m")


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Properties of one device.

    Attributes
    ----------
    serial
        Serial number of its USB adapter or another identifier; may be empty.
    measured
        Its own calibration; None if it has only the generic one.
    finger
        The finger it was tuned on; None before tuning.
    servo_lag_s
        Time constant [s] of its servos, if identified.

    Raises
    ------
    SettingsError
        If a value is invalid.
    """

    serial: str = ""
    measured: MeasuredCalibration | None = None
    finger: MeasuredFinger | None = None
    servo_lag_s: float | None = None

    def __post_init__(self) -> None:
        if len(self.serial) > LONGEST_SERIAL or not self.serial.isprintable():
            raise SettingsError(
                f"serial is {reprlib.repr(self.serial)}; it must be at most {LONGEST_SERIAL} printable characters"
            )
        if self.servo_lag_s is not None:
            check_parameter("servo lag", self.servo_lag_s, 1e-4, 1.0, "s")

    @property
    def calibration(self) -> Calibration:
        """Its own calibration, or the generic one."""
        return self.measured.calibration if self.measured else GENERIC_CALIBRATION

    @property
    def is_generic(self) -> bool:
        """Whether the device was never calibrated; its forces may then be far off."""
        return self.measured is None


def _as_text(day: Any) -> Any:
    """Return an unquoted day, which TOML reads as a date, as text."""
    return day.isoformat() if hasattr(day, "isoformat") else day


_Day: TypeAlias = Annotated[str, BeforeValidator(_as_text)]


class _CalibrationTable(BaseModel):
    model_config = STRICT

    date: _Day
    residual_rms_n: float
    pairs: int
    counts: list[float]
    forces_n: list[float]


class _FingerTable(BaseModel):
    model_config = STRICT

    stiffness_n_m: float
    contact_m: float
    date: _Day


class _ProfileTable(BaseModel):
    model_config = STRICT

    serial: str = ""
    servo_lag_s: float | None = None
    calibration: _CalibrationTable | None = None
    finger: _FingerTable | None = None


def load_profile(path: Path) -> Profile:
    """Return the profile in a TOML file.

    Raises
    ------
    FileError
        If the file is missing, unreadable or not TOML.
    SettingsError
        If a key is unknown or missing, or a value is invalid.
    """
    return parse_profile(read_document(path), str(path))


def parse_profile(text: str, source: str) -> Profile:
    """Return the profile described by `text`; messages name `source` as its origin.

    Raises
    ------
    FileError
        If the text is not TOML; the message has the line and column.
    SettingsError
        If a key is unknown or missing, or a value is invalid.
    """
    table = parse_document(text, source, _ProfileTable)
    try:
        return Profile(
            serial=table.serial,
            measured=_measured(table.calibration) if table.calibration else None,
            finger=MeasuredFinger(**table.finger.model_dump()) if table.finger else None,
            servo_lag_s=table.servo_lag_s,
        )
    except SettingsError as error:
        raise SettingsError(f"{source}: {error}") from error


def dump_profile(profile: Profile) -> str:
    """Return a profile as TOML, which `parse_profile` reads back as the same profile."""
    content: dict[str, Any] = {"serial": profile.serial}
    if profile.servo_lag_s is not None:
        content["servo_lag_s"] = profile.servo_lag_s
    if profile.measured is not None:
        content["calibration"] = {
            "date": profile.measured.date,
            "residual_rms_n": profile.measured.residual_rms_n,
            "pairs": profile.measured.pairs,
            "counts": profile.measured.calibration.counts,
            "forces_n": profile.measured.calibration.forces_n,
        }
    if profile.finger is not None:
        content["finger"] = dataclasses.asdict(profile.finger)
    return tomli_w.dumps(content)


def _measured(table: _CalibrationTable) -> MeasuredCalibration:
    return MeasuredCalibration(
        calibration=Calibration(tuple(table.counts), tuple(table.forces_n)),
        date=table.date,
        residual_rms_n=table.residual_rms_n,
        pairs=table.pairs,
    )


def _check_date(name: str, date: str) -> None:
    if not re.fullmatch(r"[0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])", date):
        raise SettingsError(f"{name} is {reprlib.repr(date)}; it must be a date such as 2026-05-04")
