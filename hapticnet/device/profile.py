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

import reprlib
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import tomli_w
from pydantic import BaseModel, BeforeValidator, ConfigDict, model_validator

from hapticnet.checks import check_parameter
from hapticnet.device.calibration import Calibration
from hapticnet.device.simulated import Sensor
from hapticnet.documents import STRICT, parse_document, read_document, text_of
from hapticnet.errors import SettingsError

LONGEST_SERIAL: Final = 200
GENERIC_FORCES_N: Final = (0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Forces [N] of the generic curve's knots: the range of the FSR 400 series, denser where it is curved."""

GENERIC_CALIBRATION: Final = Calibration(
    tuple(Sensor().counts(force_n) for force_n in GENERIC_FORCES_N), GENERIC_FORCES_N
)
"""A typical FSR 408 with 10 kΩ, from its data sheet; sensors differ by about 6 %."""

_FROZEN: Final = ConfigDict(**STRICT, frozen=True)

_Day: TypeAlias = Annotated[  # a day, as YYYY-MM-DD
    str,
    # TOML reads an unquoted day as a date.
    BeforeValidator(lambda day: day.isoformat() if hasattr(day, "isoformat") else day),
    text_of(r"[0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])", "a date such as 2026-05-04"),
]


class MeasuredCalibration(BaseModel):
    """A measured calibration: its table, when it was measured, and how well it fits. SettingsError if it is invalid."""

    model_config = _FROZEN

    date: _Day
    residual_rms_n: float  # root mean square [N] of the residuals of the measured pairs
    pairs: int  # number of measured pairs
    counts: list[float]
    forces_n: list[float]

    @property
    def table(self) -> Calibration:
        """The counts and forces as a table."""
        return Calibration(tuple(self.counts), tuple(self.forces_n))

    @model_validator(mode="after")
    def _check(self) -> "MeasuredCalibration":
        check_parameter("calibration residual", self.residual_rms_n, 0.0, 100.0, "N")
        check_parameter("calibration pairs", self.pairs, 2, 1_000_000_000)
        _ = self.table  # whose values it checks
        return self


class MeasuredFinger(BaseModel):
    """A finger as measured by the device. SettingsError if it is invalid."""

    model_config = _FROZEN

    stiffness_n_m: float  # tangent stiffness [N/m] at 1 N
    contact_m: float  # platform displacement [m] at which it touches the finger
    date: _Day

    @model_validator(mode="after")
    def _check(self) -> "MeasuredFinger":
        check_parameter("finger stiffness", self.stiffness_n_m, 1.0, 1e5, "N/m")
        check_parameter("finger contact", self.contact_m, 0.0, 0.05, "m")
        return self


class Profile(BaseModel):
    """Properties of one device. SettingsError if a value is invalid."""

    model_config = _FROZEN

    serial: str = ""  # serial number of its USB adapter or another identifier; may be empty
    servo_lag_s: float | None = None  # time constant [s] of its servos, if identified
    calibration: MeasuredCalibration | None = None  # its own calibration; None if it has only the generic one
    finger: MeasuredFinger | None = None  # the finger it was tuned on; None before tuning

    @model_validator(mode="after")
    def _check(self) -> "Profile":
        if len(self.serial) > LONGEST_SERIAL or not self.serial.isprintable():
            raise SettingsError(
                f"serial is {reprlib.repr(self.serial)}; it must be at most {LONGEST_SERIAL} printable characters"
            )
        if self.servo_lag_s is not None:
            check_parameter("servo lag", self.servo_lag_s, 1e-4, 1.0, "s")
        return self

    @property
    def table(self) -> Calibration:
        """Its own calibration, or the generic one."""
        return self.calibration.table if self.calibration else GENERIC_CALIBRATION

    @property
    def is_generic(self) -> bool:
        """Whether the device was never calibrated; its forces may then be far off."""
        return self.calibration is None

    def changed(self, **values: Any) -> "Profile":
        """Return this profile with other values."""
        return Profile(**{**dict(self), **values})


def load_profile(path: Path) -> Profile:
    """Return the profile in a TOML file.

    Raises FileError if the file is missing, unreadable or not TOML; SettingsError if a key is unknown or missing, or a
    value is invalid.
    """
    return parse_profile(read_document(path), str(path))


def parse_profile(text: str, source: str) -> Profile:
    """Return the profile described by `text`; messages name `source` as its origin. Raises what `load_profile` does."""
    return parse_document(text, source, Profile)


def dump_profile(profile: Profile) -> str:
    """Return a profile as TOML, which `parse_profile` reads back as the same profile."""
    return tomli_w.dumps(profile.model_dump(exclude_none=True))
