"""``hapticnet device monitor``: show the force sensor's readings without motion."""

from pathlib import Path
from typing import Annotated

import typer

from hapticnet import options

SHOW_EVERY_US = 100_000


def monitor(
    device: Annotated[str, typer.Argument(metavar="DEVICE", help="serial:PORT[@BAUD] or serial:auto.")] = "serial:auto",
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this many seconds. Default: on Ctrl-C.")
    ] = None,
    profile: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Profile with the device's calibration. Default: a typical one.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write every reading to FILE as CSV.")] = None,
    json: options.Json = False,
) -> None:
    """Show live force, counts and displacement of a device that stays retracted, then a summary."""
    from hapticnet.cli.console import Console, check_outputs, deliver
    from hapticnet.device.base import Reading
    from hapticnet.device.wired import WiredDevice
    from hapticnet.recordings.tables import write_csv
    from hapticnet.runtime import devices
    from hapticnet.runtime.serial_port import Wire, parse_serial, run_device
    from hapticnet.runtime.system import run

    spec = parse_serial(device)
    known = devices.load(profile)
    check_outputs(csv, inputs=[profile])
    wired = WiredDevice(known.calibration)
    console = Console("monitor", real_time=True)
    summary = Summary()
    rows: list[Reading] = []
    last: Reading | None = None
    shown_us = 0

    def tick(now_us: int) -> bool:
        nonlocal last, shown_us
        reading = wired.exchange(0.0, now_us)
        if reading is not None and reading is not last:
            summary.add(reading.force_n, reading.adc, reading.t_us)
            if csv is not None:
                rows.append(reading)
        if (reading is None) != (last is None):
            console.say("receiving readings" if reading else f"no readings: {wired.status}")
        last = reading
        if now_us - shown_us >= SHOW_EVERY_US:
            shown_us = now_us
            console.status(
                f"{reading.force_n:6.3f} N  {reading.adc:7.2f} counts  {1e3 * reading.displacement_m:6.3f} mm"
                if reading
                else wired.status
            )
        return False

    console.say(f"opening {spec}" + ("; not calibrated, forces are rough" if known.is_generic else ""))
    run(run_device(Wire(wired=wired, spec=spec), tick, duration_s=duration))
    console.finish()
    if csv is not None:
        columns = zip(*rows, strict=True) if rows else [()] * len(Reading._fields)
        write_csv(csv, dict(zip(Reading._fields, map(list, columns), strict=True)))
    deliver(
        {"device": str(spec), "calibrated": not known.is_generic, **summary.report(), "line": wired.report()},
        as_json=json,
        file=None,
    )


class Summary:
    """Running mean and standard deviation of readings, in constant memory."""

    def __init__(self) -> None:
        self.readings = 0
        self._mean_n = self._squares = self._mean_counts = 0.0
        self._first_us = self._last_us = 0

    def add(self, force_n: float, adc: float, t_us: int) -> None:
        """Add a reading."""
        if not self.readings:
            self._first_us = t_us
        self._last_us = t_us
        self.readings += 1
        # Welford's recurrence, which is numerically stable.
        above_n = force_n - self._mean_n
        self._mean_n += above_n / self.readings
        self._squares += above_n * (force_n - self._mean_n)
        self._mean_counts += (adc - self._mean_counts) / self.readings

    def report(self) -> dict[str, object]:
        """Return the statistics; None where there are too few readings."""
        seconds = (self._last_us - self._first_us) * 1e-6
        return {
            "readings": self.readings,
            "readings_per_s": (self.readings - 1) / seconds if seconds > 0.0 else None,
            "mean_n": self._mean_n if self.readings else None,
            "deviation_n": (self._squares / (self.readings - 1)) ** 0.5 if self.readings > 1 else None,
            "mean_counts": self._mean_counts if self.readings else None,
        }
