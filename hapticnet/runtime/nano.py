"""The whole device without hardware: the compiled firmware with its servo pins and converter on the simulated plant.

It runs in virtual time: the same calls give the same results, to the byte.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.device.base import Device, Reading
from hapticnet.device.simulated import Plant, PlantSettings, loading_calibration
from hapticnet.device.wired import WiredDevice
from hapticnet.errors import UnavailableError
from hapticnet.runtime.simavr import CYCLES_PER_US, Simavr, simavr_build

SLICE_US: Final = 1_000
"""Interval [µs] at which the converter's voltage follows the plant; the firmware averages over the same time."""

LONGEST_GAP_US: Final = 2_000_000
"""Longest gap [µs] that is simulated; after it the firmware has long retracted and the servos are at rest."""

SHORTEST_PULSE_US: Final = 500.0
LONGEST_PULSE_US: Final = 2_500.0
"""Limits [µs] of a pulse that a servo accepts; a shorter one may come from a reset. Typical of hobby servos."""

SUPPLY_MV: Final = 5_000.0
"""Full scale of the converter [mV], whose reference is the supply."""

SensorHook: TypeAlias = Callable[[float, int], float]
"""Converter input [counts] as a function of the sensor's output [counts] and the time [µs]; models faults."""


class Board:
    """The firmware on its board, connected to the plant: pulses out, sensor voltage in.

    Parameters
    ----------
    settings
        Settings of the plant.
    rng
        Source of the plant's noise.
    build
        Simulator and firmware; default: those that `simavr_build` finds.

    Attributes
    ----------
    plant
        The mechanics.
    sensor
        Fault of the sensor, if any.
    resets
        Number of resets of the controller since power-on.

    Raises
    ------
    UnavailableError
        If there is no build, or the simulator does not start.
    """

    def __init__(
        self, settings: PlantSettings, rng: np.random.Generator, *, build: tuple[Path, Path] | None = None
    ) -> None:
        self.plant = Plant(settings, rng)
        self.sensor: SensorHook | None = None
        self.resets = 0
        self._simavr = Simavr(*(build or simavr_build()))
        self._millivolts_per_count = SUPPLY_MV / (1 << settings.sensor.adc_bits)
        self._now_us = 0
        self._power_on_us = 0.0  # on the caller's clock
        self._cycle = 0
        self._rises: list[int | None] = [None, None, None]

    def set_clock(self, now_us: int) -> None:
        """Set the present time to `now_us` [µs]; simulation continues from here."""
        self._now_us = now_us
        self._power_on_us = now_us - self._cycle / CYCLES_PER_US
        self.plant.advance(now_us)

    def advance(self, now_us: int, data: bytes = b"") -> bytes:
        """Advance time to `now_us` [µs], by a slice at most; pass bytes at its start and return the output.

        Raises
        ------
        UnavailableError
            If the simulator has ended.
        """
        plant = self.plant
        counts = plant.level_counts()
        if self.sensor is not None:
            counts = self.sensor(counts, self._now_us)
        # Steps may be a few cycles too long; counting from power-on keeps the excess from accumulating.
        duration_us = round(now_us - self._power_on_us - self._cycle / CYCLES_PER_US)
        step = self._simavr.advance(max(0, duration_us), millivolts=counts * self._millivolts_per_count, data=data)
        self._now_us = now_us
        self._cycle = step.cycle
        self.resets = step.resets
        for cycle, servo, level in step.edges:
            rise = self._rises[servo]
            if level:
                self._rises[servo] = cycle
            elif rise is not None:  # the initial level of a pin is also reported as an edge
                width_us = (cycle - rise) / CYCLES_PER_US
                if SHORTEST_PULSE_US <= width_us <= LONGEST_PULSE_US:
                    plant.advance(self._power_on_us + cycle / CYCLES_PER_US)
                    plant.take_one(servo, width_us)
        plant.advance(self._power_on_us + step.cycle / CYCLES_PER_US)
        return step.sent

    def close(self) -> None:
        """End the simulation."""
        self._simavr.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Disturbance of what the host writes.

    Attributes
    ----------
    delay_us
        Delay [µs].
    loss
        Share of writes that are lost (0 to 1), requests included.

    Raises
    ------
    SettingsError
        If a value is out of range.
    """

    delay_us: int = 0
    loss: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("delay", self.delay_us, 0, 10_000_000, "µs")
        check_parameter("loss", self.loss, 0, 1)


class SimulatedNano(Device):
    """The fingertip device in lockstep: host's end of the line, firmware and plant.

    Each `exchange` first advances board, plant and line to the given time. `close` ends the simulator. If the simulator
    ends by itself, the device is lost.

    Parameters
    ----------
    settings
        Settings of the plant.
    rng
        Source of noise and losses.
    wired
        The host's end; default: one that knows linkage, servos and sensor of the plant.
    build
        Simulator and firmware; default: those that `simavr_build` finds.
    disturbance
        Disturbance of what the host writes.

    Attributes
    ----------
    board
        Firmware and plant; set `board.sensor` for a sensor fault.
    plant
        The mechanics.
    wired
        The host's end of the wire.
    """

    def __init__(
        self,
        settings: PlantSettings,
        rng: np.random.Generator,
        *,
        wired: WiredDevice | None = None,
        build: tuple[Path, Path] | None = None,
        disturbance: Disturbance | None = None,
    ) -> None:
        self.board = Board(settings, rng, build=build)
        self.plant = self.board.plant
        self.wired = wired or WiredDevice(
            loading_calibration(settings.sensor), linkage=settings.linkage, servo=settings.servo
        )
        self.travel_m = self.wired.travel_m
        self.delay_us = self.wired.delay_us
        self.max_force_n = self.wired.max_force_n
        self.description = (
            f"simulated Nano with the compiled firmware, finger {settings.finger.stiffness_n_m / 1000.0:g} N/mm at 1 N"
        )
        self.status = self.wired.status
        self._disturbance = disturbance or Disturbance()
        self._loss_rng = rng.spawn(1)[0]
        self._under_way: deque[tuple[int, bytes]] = deque()
        self._now_us: int | None = None
        self._plugged = True

    @property
    def contact_force_n(self) -> float:
        """True force [N] on the finger, unknown to real devices."""
        return self.plant.contact_force_n

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the platform displacement [m] and return the newest reading, or None while the device is lost.

        A repeated or earlier time advances nothing, and the clock continues from it.
        """
        try:
            self._advance(now_us)
        except UnavailableError as error:
            self.wired.closed(str(error), now_us)
        reading = self.wired.exchange(displacement_m, now_us)
        self.status = self.wired.status
        return reading

    def report(self) -> dict[str, Any]:
        """Return the counters of the line, for JSON."""
        return self.wired.report()

    def pull_plug(self, now_us: int) -> None:
        """Disconnect the line; the firmware keeps running."""
        self._plugged = False
        self._under_way.clear()
        self.wired.closed("unplugged", now_us)

    def plug_in(self, now_us: int) -> None:
        """Reconnect the line; unlike with a real port, this does not reset the controller."""
        self._plugged = True
        self.wired.opened(now_us)

    def close(self) -> None:
        """End the simulation."""
        self.board.close()

    def _advance(self, now_us: int) -> None:
        at_us = self._now_us
        if at_us is None and self._plugged:
            self.wired.opened(now_us)
        if at_us is None or not 0 <= now_us - at_us <= LONGEST_GAP_US:
            at_us = now_us if at_us is None or now_us < at_us else now_us - LONGEST_GAP_US
            self.board.set_clock(at_us)
            self._under_way.clear()
        while at_us < now_us:
            data = self._arriving(at_us)
            at_us = min(at_us + SLICE_US, now_us)
            sent = self.board.advance(at_us, data)
            if self._plugged and sent:
                self.wired.receive(sent, at_us)
        self._now_us = now_us

    def _arriving(self, now_us: int) -> bytes:
        """Take what the host writes, and return what reaches the board."""
        data = self.wired.bytes_to_send()
        disturbance = self._disturbance
        if data and not (disturbance.loss and self._loss_rng.random() < disturbance.loss):
            self._under_way.append((now_us + disturbance.delay_us, data))
        arriving = b""
        while self._under_way and self._under_way[0][0] <= now_us:
            arriving += self._under_way.popleft()[1]
        return arriving
