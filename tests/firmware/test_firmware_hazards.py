"""Tests of docs/understand/safety.md on the compiled firmware under load, in virtual time; the sensor's are last."""

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.device.calibration import Calibration
from hapticnet.device.messages import Setpoint, encode, frame
from hapticnet.device.profile import GENERIC_CALIBRATION
from hapticnet.node.fingertip import DeviceFound, DeviceLost, ForceFault
from tests.firmware.rig import FINGERS_N_M, HANG, MS, RETRACT_MS, released_ms


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_stimulus_that_goes_stale_releases_the_finger(pressing: Any, stiffness_n_m: float) -> None:
    made = pressing(stiffness_n_m)
    settings = HoldSettings(rise_n_per_s=1e6)  # the force is pressed already
    hold = Hold(settings)
    hold.receive((3.0,), made.now_us)
    felt_n = made.play(lambda now_us: hold.value(now_us)[0], 800)
    assert min(felt_n[:200]) > 2.5
    assert max(felt_n) <= 3.3
    assert released_ms(felt_n) <= (settings.age_limit_us + settings.decay_us) // MS + RETRACT_MS


def test_no_target_causes_more_than_5_n(rig: Any) -> None:
    made = rig()
    chance = random.Random(4)
    wild = (math.nan, math.inf, -math.inf, 1e300, -5.0, 5e-324, 50.0, 0.0)
    made.play(lambda _: chance.choice(wild), 1_000)
    made.play(lambda now_us: wild[now_us // 300_000 % len(wild)], 4_800)
    assert 4.0 < max(made.felt_n) <= 5.0


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_stalled_host_releases_the_finger_and_comes_back_softly(pressing: Any, stiffness_n_m: float) -> None:
    made = pressing(stiffness_n_m)
    felt_n = made.stall(500)
    assert min(felt_n[:180]) > 2.5
    assert released_ms(felt_n) <= 220 + RETRACT_MS
    assert max(felt_n) <= 3.3
    made.press(3.0, 1)
    assert made.fingertip.target_n == 0.0
    assert max(made.press(3.0, 1_800)) <= 3.3
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize(
    ("stiffness_n_m", "told"),
    [(300.0, True), (1000.0, True), (3000.0, True), (1000.0, False)],
    ids=["soft", "usual", "stiff", "without a hang-up"],
)
def test_an_unplugged_device_is_detected_within_100_ms_and_releases_the_finger(
    pressing: Any, stiffness_n_m: float, told: bool
) -> None:
    made = pressing(stiffness_n_m)
    at_ms = made.now_us // MS
    wired = made.nano.wired
    wired.bytes_to_send, wired.receive = bytes, lambda *_: None
    if told:
        wired.closed("unplugged", made.now_us)
    felt_n = made.press(3.0, 600)
    (lost_ms,) = made.times_ms(DeviceLost)
    assert lost_ms - at_ms <= (1 if told else 100)
    assert (made.nano.status == "unplugged") == told
    assert released_ms(felt_n) <= 220 + RETRACT_MS
    assert max(felt_n[released_ms(felt_n) :]) == 0.0
    del wired.bytes_to_send, wired.receive
    wired.opened(made.now_us)
    assert max(made.press(3.0, 1_800)) <= 3.3
    assert len(made.times_ms(DeviceFound)) == 2
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)
    assert made.nano.board.resets == 0


@pytest.mark.parametrize("sequence", [HANG, HANG + 1, HANG + 2], ids=["main loop", "all of it", "servo frames"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_hung_firmware_is_reset_releases_the_finger_and_comes_back_softly(
    pressing: Any, stiffness_n_m: float, sequence: int
) -> None:
    made = pressing(stiffness_n_m, hanging=True)
    board, at_ms = made.nano.board, made.now_us // MS
    pulses = [round(2.0 * pulse_us) for pulse_us in made.nano.wired._setpoints.held_us]
    poison = frame(encode(Setpoint(sequence, *pulses)))
    made.also_send(lambda: b"" if board.resets else poison)
    felt_n = made.press(3.0, 400)
    assert board.resets == 1
    # A soft finger is found again before it is completely released.
    assert min(felt_n[: 150 + RETRACT_MS]) < 0.5
    (lost_ms,) = made.times_ms(DeviceLost)
    assert lost_ms - at_ms <= 220
    assert max(felt_n + made.press(3.0, 1_800)) <= 3.3
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)
    line = made.fingertip.report()["line"]
    assert line["reset_cause"] == "watchdog"
    assert line["times_lost"] == 1


@pytest.mark.parametrize("dark_ms", [2, 1_500], ids=["at once", "through a bootloader"])
def test_a_reset_is_detected_and_the_finger_released_when_the_firmware_runs_again(pressing: Any, dark_ms: int) -> None:
    made = pressing()
    dark_n = made.restart(3.0, dark_ms)
    # There are no pulses in the bootloader; servos that hold without them keep pressing.
    assert min(dark_n) > 2.5
    felt_n = made.press(3.0, 2_000)
    assert released_ms(felt_n) <= 40 + RETRACT_MS
    assert max(felt_n) <= 3.3
    assert felt_n[-1] == pytest.approx(3.0, rel=0.1)
    assert len(made.times_ms(DeviceLost)) == 1
    assert len(made.times_ms(DeviceFound)) == 2


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_garbage_on_the_line_releases_the_finger_without_an_increase(pressing: Any, stiffness_n_m: float) -> None:
    made = pressing(stiffness_n_m)
    chance, wired = random.Random(2), made.nano.wired
    writes, hears = wired.bytes_to_send, wired.receive

    def spoiled(data: bytes) -> bytes:
        noise = bytearray(data + chance.randbytes(chance.randint(0, 20)))
        for _ in range(len(noise) // 8):
            noise[chance.randrange(len(noise))] = chance.randrange(256)
        return bytes(noise)

    wired.bytes_to_send = lambda: spoiled(writes())
    wired.receive = lambda data, now_us: hears(spoiled(data), now_us)
    assert max(made.press(3.0, 1_000)) <= 3.3
    assert made.felt_n[-1] == 0.0
    wired.bytes_to_send, wired.receive = writes, hears
    assert max(made.press(3.0, 1_800)) <= 3.3
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)
    report = wired.report()
    assert report["frames_damaged"] > 0
    assert report["device_frames_damaged"] > 0
    assert made.nano.board.resets == 0


@pytest.mark.parametrize(("blocked", "noticed"), [(1, False), (2, False), (3, True)])
def test_blocked_servos_press_no_harder_and_only_three_are_detected(pressing: Any, blocked: int, noticed: bool) -> None:
    made = pressing(force_n=2.0)
    plant = made.nano.plant
    made.nano.board.plant = Blocked(plant, blocked)
    assert max(made.press(4.5, 1_500)) <= 5.0
    assert bool(made.times_ms(ForceFault)) == noticed
    assert made.press(0.0, 1_000)[-1] == pytest.approx((0.0, 0.56, 2.02)[blocked - 1], abs=0.1)


class Blocked:
    """A plant whose first servos are blocked."""

    def __init__(self, plant: Any, servos: int) -> None:
        self._plant, self._servos = plant, servos

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def take_one(self, index: int, pulse_us: float) -> None:
        if index >= self._servos:
            self._plant.take_one(index, pulse_us)


def open_input(kind: str) -> Callable[[float, int], float]:
    """Return the reading of a floating input: mains hum at a phase, or noise over the range."""
    if kind == "noise":
        chance = random.Random(3)
        return lambda _counts, _now_us: chance.uniform(0.0, 1023.0)
    hertz, phase = (float(part.split()[0]) for part in kind.split(" at "))
    return lambda _counts, now_us: 400.0 + 300.0 * math.sin(2.0 * math.pi * (hertz * now_us * 1e-6 + phase / 360.0))


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [1.0, 4.6])
def test_a_sensor_that_fails_while_pressing_adds_no_force_and_is_released_with_the_target(
    pressing: Any, stiffness_n_m: float, force_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=force_n)
    before_n = made.felt_n[-1]
    made.nano.board.sensor = lambda _counts, _now_us: 0.0
    felt_n = made.press(force_n, 1_000)
    assert max(felt_n) <= before_n + 0.05
    # Without a change of the reading the platform rests, and the force on the finger stays.
    assert np.ptp(felt_n[-500:]) < 0.05
    assert 0.8 < felt_n[-1] < 1.8
    assert released_ms(made.press(0.0, 400)) <= RETRACT_MS
    assert max(made.press(force_n, 1_000)) < 1.8


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("counts", [100.0, 500.0])
def test_after_an_unexplained_fall_the_platform_stops_and_releases_with_the_target(
    pressing: Any, stiffness_n_m: float, counts: float
) -> None:
    made = pressing(stiffness_n_m, force_n=4.6)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(4.6, 1_000)) <= 5.0
    assert released_ms(made.press(0.0, 500)) <= 2 * RETRACT_MS
    # On the next approach, it is stuck at an intermediate value.
    assert max(made.press(4.6, 1_000)) == 0.0
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("counts", ["50 Hz at 0 deg", "50 Hz at 90 deg", "50 Hz at 162 deg", "60 Hz at 0 deg", "noise"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [None, 1.0, 4.6], ids=["from the start", "1 N", "4.6 N"])
def test_an_open_input_that_hums_or_jumps_is_detected_and_the_finger_released(
    rig: Any, pressing: Any, stiffness_n_m: float, force_n: float | None, counts: str
) -> None:
    made = rig(stiffness_n_m) if force_n is None else pressing(stiffness_n_m, force_n=force_n)
    before_n = max(made.felt_n, default=0.0)
    made.nano.board.sensor = open_input(counts)
    felt_n = made.press(force_n or 4.6, 600)
    assert max(felt_n) <= before_n + 0.1
    assert released_ms(felt_n) <= 400
    assert felt_n[-1] == 0.0
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [1.0, 4.6])
def test_a_sensor_shorted_to_the_supply_releases_the_finger(
    pressing: Any, stiffness_n_m: float, force_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=force_n)
    made.nano.board.sensor = lambda _counts, _now_us: 1023.0
    at_ms, before_n = made.now_us // MS, made.felt_n[-1]
    felt_n = made.press(force_n, 500)
    assert max(felt_n) <= before_n + 0.05
    assert released_ms(felt_n) <= 2 * RETRACT_MS
    (noticed_ms,) = made.times_ms(ForceFault)
    assert noticed_ms - at_ms <= 100
    made.nano.board.sensor = None
    made.press(0.0, 300)
    assert max(made.press(force_n, 1_800)) <= 5.0
    assert made.felt_n[-1] == pytest.approx(force_n, rel=0.1, abs=0.15)


@pytest.mark.parametrize("counts", [0.0, 1023.0], ids=["disconnected", "shorted"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_sensor_dead_from_the_start_never_causes_more_than_5_n(rig: Any, stiffness_n_m: float, counts: float) -> None:
    made = rig(stiffness_n_m)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(5.0, 1_000)) <= (0.0 if counts else 5.0)


@pytest.mark.parametrize("counts", [100.0, 500.0])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_sensor_stuck_from_the_start_is_detected_before_contact(
    rig: Any, stiffness_n_m: float, counts: float
) -> None:
    made = rig(stiffness_n_m)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(5.0, 1_000)) == 0.0
    assert made.times_ms(ForceFault)[0] <= 300


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize(("from_n", "to_n", "most_n"), [(1.0, 3.0, 2.6), (3.0, 5.0, 5.0), (3.0, 0.0, 3.1)])
def test_a_frozen_sensor_is_detected_when_the_platform_moves(
    pressing: Any, stiffness_n_m: float, from_n: float, to_n: float, most_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=from_n)
    frozen = made.fingertip.reading.adc
    made.nano.board.sensor = lambda _counts, _now_us: frozen
    assert max(made.press(from_n, 300)) <= 1.05 * from_n
    felt_n = made.press(to_n, 800)
    assert max(felt_n) <= most_n
    assert released_ms(felt_n) <= 400
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_the_target_is_limited_to_the_end_of_the_table(rig: Any, stiffness_n_m: float) -> None:
    table = GENERIC_CALIBRATION
    made = rig(stiffness_n_m, calibration=Calibration(table.counts[:7], table.forces_n[:7]))
    assert made.nano.capabilities.max_force_n == 3.0
    assert 2.5 < max(made.press(5.0, 2_500)) <= 3.2
    assert not made.times_ms(ForceFault)


def test_a_table_that_reads_too_little_presses_too_hard_undetected(rig: Any) -> None:
    table = GENERIC_CALIBRATION
    made = rig(calibration=Calibration(table.counts, tuple(0.8 * force_n for force_n in table.forces_n)))
    made.press(2.0, 2_000)
    assert made.felt_n[-1] == pytest.approx(2.0 / 0.8, rel=0.06)
    assert not made.times_ms(ForceFault)
