"""``hapticnet device calibrate``: calibrate the force sensor."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

import typer

from hapticnet import options
from hapticnet.cli.device.wired import Port, profile_to_write, run_wired

if TYPE_CHECKING:
    from hapticnet.device.calibration import Fit
    from hapticnet.runtime.serial_port import SerialSpec

WINDOW_US: Final = 500_000
"""Time [µs] over which the readings of one force are averaged, to remove noise and the tremor of a hand."""

Pairs: TypeAlias = list[tuple[float, float]]  # pairs of a force [N] and its counts


def calibrate(
    device: Port = "serial:auto",
    profile: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Profile to update; its serial and finger are kept.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Profile to write. Default: the --profile, or device.toml.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Measure known forces, fit the force sensor's calibration, report the residuals, and write it to a profile."""
    import datetime

    from hapticnet.cli.console import deliver, write_text
    from hapticnet.device.calibration import fit_calibration
    from hapticnet.device.profile import MeasuredCalibration, dump_profile
    from hapticnet.runtime import devices
    from hapticnet.runtime.serial_port import parse_serial

    known = devices.load(profile)
    file = profile_to_write(profile, out or (Path("device.toml") if profile is None else None))
    assert file is not None  # noqa: S101 - one of the three it is
    spec = parse_serial(device)
    known = known.changed(serial=_serial_number(spec) or known.serial)
    measured = _measure(spec)
    fit = fit_calibration([adc for _, adc in measured], [force_n for force_n, _ in measured])
    # Nine decimals are far below any sensor's noise and keep the file readable.
    record = MeasuredCalibration(
        date=datetime.date.today().isoformat(),
        residual_rms_n=round(fit.rms_n, 9),
        pairs=sum(residual_n is not None for residual_n in fit.residuals_n),
        counts=[round(adc, 9) for adc in fit.calibration.counts],
        forces_n=[round(force_n, 9) for force_n in fit.calibration.forces_n],
    )
    write_text(file, dump_profile(known.changed(calibration=record)))
    account = _account(measured, fit, file)
    if json:
        deliver(account, as_json=True, file=None)
    else:
        print("\n".join(_table(account)))


class CalibrationSession:
    """A guided calibration: takes typed lines and sensor readings, and returns messages for the person."""

    PROMPT: Final = "apply a force, hold it, type its value in N and press Enter (empty line: end): "

    def __init__(self) -> None:
        self.pairs: Pairs = []  # pairs measured so far
        self.finished = False  # whether the person has ended the session
        self._ending = False
        self._force_n: float | None = None
        self._started_us = 0
        self._sum = 0.0
        self._readings = 0

    def typed(self, line: str, now_us: int) -> str | None:
        """Take a typed line; return a message, or None if a measurement begins or the session ends."""
        from hapticnet.device.calibration import LARGEST_FORCE_N

        if not line.strip():
            # Finish the measurement in progress first.
            self._ending = True
            self.finished = self._force_n is None
            return None
        if self._force_n is not None:
            return "still measuring the last force; keep holding it"
        try:
            force_n = float(line)
        except ValueError:
            force_n = math.nan
        if not 0.0 <= force_n <= LARGEST_FORCE_N:
            return f"{line.strip()[:20]!r} is not a force between 0 and {LARGEST_FORCE_N:g} N; type for example 1.5"
        self._force_n = force_n
        self._started_us = now_us
        self._sum = 0.0
        self._readings = 0
        return None

    def read(self, adc: float | None, now_us: int) -> str | None:
        """Take a reading [counts], or None while the device is lost; return a message when a measurement ends."""
        from hapticnet.device.calibration import FULL_SCALE_COUNTS

        if self._force_n is None:
            return None
        if adc is None:
            self._force_n = None
            self.finished = self._ending
            return "the device was lost during the measurement; once it is back, apply and type this force again"
        self._sum += adc
        self._readings += 1
        if now_us - self._started_us < WINDOW_US:
            return None
        force_n, self._force_n = self._force_n, None
        self.finished = self._ending
        mean = self._sum / self._readings
        self.pairs.append((force_n, mean))
        remark = " (saturated: will be ignored)" if mean > FULL_SCALE_COUNTS - 1.0 else ""
        if mean == 0.0 < force_n:
            remark = " (the sensor reads 0: is it wired and pressed?)"
        return f"pair {len(self.pairs)}: {force_n:g} N, {mean:.1f} counts{remark}"


def _serial_number(spec: "SerialSpec") -> str | None:
    """Return the serial number of a port's USB device; None if it has none, like most clones."""
    import os

    from hapticnet.runtime.serial_port import choose_port, find_ports

    port = os.path.realpath(spec.path or choose_port())
    return next((found.serial_number for found in find_ports() if os.path.realpath(found.name) == port), None)


def _account(measured: Pairs, fit: "Fit", file: Path) -> dict[str, Any]:
    return {
        "profile": str(file),
        "rms_n": fit.rms_n,
        "max_n": fit.max_n,
        "hysteresis": fit.hysteresis,
        "saturated": fit.residuals_n.count(None),
        "pairs": [
            {"force_n": force_n, "adc": adc, "residual_n": residual_n}
            for (force_n, adc), residual_n in zip(measured, fit.residuals_n, strict=True)
        ],
        "knots": [
            {"adc": adc, "force_n": force_n}
            for adc, force_n in zip(fit.calibration.counts, fit.calibration.forces_n, strict=True)
        ],
    }


def _table(account: dict[str, Any]) -> list[str]:
    from hapticnet.hardware import MAX_FORCE_N

    lines = [f"{'pair':>6}{'force [N]':>11}{'adc':>8}{'table [N]':>11}{'residual [N]':>14}"]
    for number, pair in enumerate(account["pairs"], start=1):
        force_n, residual_n = pair["force_n"], pair["residual_n"]
        fitted = "saturated" if residual_n is None else f"{force_n + residual_n:.3f}"
        missed = "–" if residual_n is None else f"{round(residual_n, 3) + 0.0:+.3f}"
        lines.append(f"{number:>6}{force_n:>11.3f}{pair['adc']:>8.1f}{fitted:>11}{missed:>14}")
    knots = account["knots"]
    lines.append(
        f"residuals: {account['rms_n']:.3f} N rms, {account['max_n']:.3f} N at most; "
        f"{len(knots)} knots up to {knots[-1]['force_n']:.2f} N"
    )
    if account["hysteresis"] is not None:
        lines.append(f"hysteresis: readings are {account['hysteresis']:.1%} higher while unloading")
    strongest_n = max(pair["force_n"] for pair in account["pairs"] if pair["residual_n"] is not None)
    if strongest_n < MAX_FORCE_N:
        lines.append(
            f"the device renders up to {MAX_FORCE_N:g} N, but above {strongest_n:g} N this table is constant; "
            "measure stronger forces as well"
        )
    lines.append(f"written to {account['profile']}")
    return lines


def _measure(spec: "SerialSpec") -> Pairs:
    """Measure pairs on a device, with prompts on stderr and input from stdin."""
    from hapticnet.device.profile import GENERIC_CALIBRATION
    from hapticnet.device.wired import WiredDevice

    wired = WiredDevice(GENERIC_CALIBRATION)
    session = CalibrationSession()
    keyboard = _Keyboard()
    prompted = False

    def tick(now_us: int) -> bool:
        nonlocal prompted
        if not prompted:
            _say(session.PROMPT, end="")
            prompted = True
        reading = wired.exchange(0.0, now_us)
        said = [session.typed(line, now_us) for line in keyboard.lines()]
        said.append(session.read(None if reading is None else reading.adc, now_us))
        for each in said:
            if each is not None:
                _say(each)
                prompted = session.finished
        return session.finished

    _say(f"opening {spec}; keep fingers out")
    if not run_wired(wired, spec, tick):
        raise typer.Exit(130)
    return session.pairs


class _Keyboard:
    """Non-blocking lines from stdin; the end of stdin counts as an empty line."""

    def __init__(self) -> None:
        import sys

        from hapticnet.errors import UnavailableError

        if sys.stdin is None or sys.stdin.closed:
            raise UnavailableError("cannot read forces: there is no stdin")
        self._fd = sys.stdin.fileno()
        self._partial = b""

    def lines(self) -> list[str]:
        import os
        import select

        if not select.select([self._fd], [], [], 0)[0]:
            return []
        data = os.read(self._fd, 4096)
        *whole, self._partial = (self._partial + (data or b"\n\n")).split(b"\n")
        return [line.decode(errors="replace") for line in whole]


def _say(text: str, *, end: str = "\n") -> None:
    import sys

    print(text, end=end, file=sys.stderr, flush=True)
