"""What docs/safety.md promises, shown on the compiled firmware under load: force loop, wire, firmware and plant in
virtual time."""

import math
import random
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticnet.control.force import ForceControlSettings
from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.control.limits import LimitSettings
from hapticnet.device.base import Reading
from hapticnet.device.calibration import Calibration
from hapticnet.device.framing import frame
from hapticnet.device.messages import Setpoint, encode
from hapticnet.device.parts import Finger
from hapticnet.device.plant import PlantSettings
from hapticnet.device.profile import GENERIC_CALIBRATION
from hapticnet.device.wired import WiredDevice
from hapticnet.node.fingertip import DeviceFound, DeviceLost, Fingertip, FingertipEvent, ForceFault
from hapticnet.runtime.nano import SimulatedNano
from hapticnet.runtime.simavr import Simavr

MS = 1_000
FINGERS_N_M = (300.0, 1000.0, 3000.0)
FOUND_AND_PRESSED_MS = 1_800
HANG = 0xDEAD

RETRACT_MS = 150
"""Longest a servo needs from anywhere a test presses to off the finger: 60° in 170 ms at most, HS-55 data sheet."""


class Rig:
    """A fingertip on a simulated Nano, and what happened to its finger, millisecond by millisecond."""

    def __init__(self, nano: SimulatedNano, build: tuple[Path, Path]) -> None:
        self.nano = nano
        self.build = build
        self.fingertip = Fingertip(nano, LimitSettings(), ForceControlSettings())
        self.now_us = 0
        self.felt_n: list[float] = []
        self.events: list[tuple[int, FingertipEvent]] = []

    def press(self, force_n: float, milliseconds: int) -> list[float]:
        """Ask for a force; return what the finger felt meanwhile."""
        return self.play(lambda _: force_n, milliseconds)

    def play(self, force_n: Callable[[int], float], milliseconds: int) -> list[float]:
        """Ask for a force by the time [µs]; return what the finger felt meanwhile."""
        for _ in range(milliseconds):
            self.now_us += MS
            self.fingertip.press(force_n(self.now_us), self.now_us)
            self.felt_n.append(self.nano.contact_force_n)
            while event := self.fingertip.next_event():
                self.events.append((self.now_us // MS, event))
        return self.felt_n[-milliseconds:]

    def stall(self, milliseconds: int) -> list[float]:
        """Let the host stand still while all else goes on; afterwards it hears all at once."""
        heard = b""
        for _ in range(milliseconds):
            self.now_us += MS
            heard += self.nano.board.advance(self.now_us)
            self.felt_n.append(self.nano.contact_force_n)
        self.nano._now_us = self.now_us
        self.nano.wired.receive(heard, self.now_us)
        return self.felt_n[-milliseconds:]

    def restart(self, force_n: float, dark_ms: int) -> list[float]:
        """Reset the controller while a force is asked for; it is dark, as in its bootloader, and starts anew."""
        board = self.nano.board
        board._simavr.close()

        def dark(now_us: int, _data: bytes = b"") -> bytes:
            board.plant.advance(now_us)
            return b""

        board.advance = dark
        felt_n = self.press(force_n, dark_ms)
        del board.advance
        board._simavr = Simavr(*self.build)
        board._cycle = 0
        board.set_clock(self.now_us)
        return felt_n

    def also_send(self, message: Callable[[], bytes]) -> None:
        """Add to what the host writes."""
        wired, usual = self.nano.wired, self.nano.wired.bytes_to_send
        wired.bytes_to_send = lambda: usual() + message()

    def times_ms(self, kind: type[FingertipEvent]) -> list[int]:
        return [at_ms for at_ms, event in self.events if isinstance(event, kind)]


@pytest.fixture
def rig(simavr_files: tuple[Path, Path], make_firmware: Callable[..., Path]) -> Iterator[Callable[..., Rig]]:
    """Return a maker of rigs: a finger's stiffness, and how it differs from the usual."""
    running: list[SimulatedNano] = []

    def make(
        stiffness_n_m: float = 1000.0, *, hanging: bool = False, calibration: Calibration | None = None, seed: int = 1
    ) -> Rig:
        elf = make_firmware("test-firmware", "BAUD=500000") / "hanging.elf" if hanging else simavr_files[1]
        build = (simavr_files[0], elf)
        settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
        wired = WiredDevice(calibration) if calibration else None
        running.append(SimulatedNano(settings, np.random.default_rng(seed), build=build, wired=wired))
        return Rig(running[-1], build)

    yield make
    for nano in running:
        nano.close()


@pytest.fixture
def pressing(rig: Callable[..., Rig]) -> Callable[..., Rig]:
    """Return a maker of rigs that press their finger with 3 N, or another force."""

    def make(stiffness_n_m: float = 1000.0, *, force_n: float = 3.0, **others: Any) -> Rig:
        made = rig(stiffness_n_m, **others)
        made.press(force_n, FOUND_AND_PRESSED_MS)
        assert made.felt_n[-1] == pytest.approx(force_n, rel=0.1, abs=0.15)
        return made

    return make


def open_input(kind: str) -> Callable[[float, int], float]:
    """Return what a floating input gives: the mains, at a phase that means over 10 ms show, or noise over the range."""
    if kind == "noise":
        chance = random.Random(3)
        return lambda _counts, _now_us: chance.uniform(0.0, 1023.0)
    turns_per_us = float(kind.split()[0]) * 1e-6
    return lambda _counts, now_us: 400.0 + 300.0 * math.sin(2.0 * math.pi * turns_per_us * now_us)


def released_ms(felt_n: list[float]) -> int:
    """Return after how many milliseconds the finger felt nothing any more."""
    assert 0.0 in felt_n, f"still {felt_n[-1]:.2f} N after {len(felt_n)} ms"
    return felt_n.index(0.0) + 1


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_stimulus_that_goes_stale_releases_the_finger(pressing: Any, stiffness_n_m: float) -> None:
    made = pressing(stiffness_n_m)
    settings = HoldSettings()
    hold = Hold(settings)
    hold.receive((3.0,), made.now_us)
    felt_n = made.play(lambda now_us: hold.value(now_us)[0], 800)
    assert min(felt_n[:200]) > 2.5
    assert max(felt_n) <= 3.3
    assert released_ms(felt_n) <= (settings.age_limit_us + settings.decay_us) // MS + RETRACT_MS


def test_whatever_is_asked_for_no_more_than_5_n_is_felt(rig: Any) -> None:
    made = rig()
    chance = random.Random(4)
    wild = (math.nan, math.inf, -math.inf, 1e300, -5.0, 5e-324, 50.0, 0.0)
    made.play(lambda _: chance.choice(wild), 1_000)
    made.play(lambda now_us: wild[now_us // 300_000 % len(wild)], 4_800)
    assert 4.0 < max(made.felt_n) <= 5.0


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_host_that_stalls_lets_the_finger_go_and_comes_back_softly(pressing: Any, stiffness_n_m: float) -> None:
    made = pressing(stiffness_n_m)
    felt_n = made.stall(500)
    assert min(felt_n[:180]) > 2.5
    assert released_ms(felt_n) <= 220 + RETRACT_MS
    assert max(felt_n) <= 3.3
    assert max(made.press(3.0, 1_800)) <= 3.3
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize(
    ("stiffness_n_m", "told"),
    [(300.0, True), (1000.0, True), (3000.0, True), (1000.0, False)],
    ids=["soft", "usual", "stiff", "without a hang-up"],
)
def test_an_unplugged_device_is_noticed_within_100_ms_and_releases_the_finger(
    pressing: Any, stiffness_n_m: float, told: bool
) -> None:
    made = pressing(stiffness_n_m)
    at_ms = made.now_us // MS
    if told:
        made.nano.pull_plug(made.now_us)
    else:
        made.nano._plugged = False
        made.nano.wired.bytes_to_send = lambda: b""
    felt_n = made.press(3.0, 600)
    (lost_ms,) = made.times_ms(DeviceLost)
    assert lost_ms - at_ms <= 100
    assert released_ms(felt_n) <= 220 + RETRACT_MS
    assert max(felt_n[released_ms(felt_n) :]) == 0.0
    vars(made.nano.wired).pop("bytes_to_send", None)
    made.nano.plug_in(made.now_us)
    assert max(made.press(3.0, 1_800)) <= 3.3
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)
    assert made.nano.board.resets == 0


@pytest.mark.parametrize("sequence", [HANG, HANG + 1, HANG + 2], ids=["main loop", "all of it", "servo frames"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_hung_firmware_is_reset_lets_go_and_comes_back_softly(
    pressing: Any, stiffness_n_m: float, sequence: int
) -> None:
    made = pressing(stiffness_n_m, hanging=True)
    board, at_ms = made.nano.board, made.now_us // MS
    pulses = [round(2.0 * pulse_us) for pulse_us in made.nano.wired._setpoints.held_us]
    poison = frame(encode(Setpoint(sequence, *pulses)))
    made.also_send(lambda: b"" if board.resets else poison)
    felt_n = made.press(3.0, 400)
    assert board.resets == 1
    # A soft finger is found again before it is quite let go of.
    assert min(felt_n[: 150 + RETRACT_MS]) < 0.5
    (lost_ms,) = made.times_ms(DeviceLost)
    assert lost_ms - at_ms <= 220
    assert max(felt_n + made.press(3.0, 1_800)) <= 3.3
    assert made.felt_n[-1] == pytest.approx(3.0, rel=0.1)
    line = made.fingertip.report()["line"]
    assert line["reset_cause"] == "watchdog"
    assert line["times_lost"] == 1


@pytest.mark.parametrize("dark_ms", [2, 1_500], ids=["at once", "through a bootloader"])
def test_a_reset_is_noticed_and_the_finger_released_when_the_firmware_runs_again(pressing: Any, dark_ms: int) -> None:
    made = pressing()
    dark_n = made.restart(3.0, dark_ms)
    # Nobody makes pulses in the bootloader: servos that hold without them go on pressing.
    assert min(dark_n) > 2.5
    felt_n = made.press(3.0, 2_000)
    assert released_ms(felt_n) <= 40 + RETRACT_MS
    assert max(felt_n) <= 3.3
    assert felt_n[-1] == pytest.approx(3.0, rel=0.1)
    assert len(made.times_ms(DeviceLost)) == 1
    assert len(made.times_ms(DeviceFound)) == 2


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_garbage_on_the_line_releases_the_finger_and_never_presses_it_more(pressing: Any, stiffness_n_m: float) -> None:
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


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [1.0, 4.6])
def test_a_sensor_that_falls_silent_is_pressed_no_harder_and_let_go_of_with_the_target(
    pressing: Any, stiffness_n_m: float, force_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=force_n)
    before_n = made.felt_n[-1]
    made.nano.board.sensor = lambda _counts, _now_us: 0.0
    felt_n = made.press(force_n, 1_000)
    assert max(felt_n) <= before_n + 0.05
    # To be left without an answer is to rest: what the finger then feels, it goes on feeling.
    assert np.ptp(felt_n[-500:]) < 0.05
    assert 0.8 < felt_n[-1] < 1.8
    assert released_ms(made.press(0.0, 400)) <= RETRACT_MS
    assert max(made.press(force_n, 1_000)) < 1.8


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("counts", [100.0, 500.0])
def test_a_sensor_that_falls_by_itself_is_pressed_no_further_and_let_go_of_with_the_target(
    pressing: Any, stiffness_n_m: float, counts: float
) -> None:
    made = pressing(stiffness_n_m, force_n=4.6)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(4.6, 1_000)) <= 5.0
    assert released_ms(made.press(0.0, 500)) <= 2 * RETRACT_MS
    # Met anew, it is stuck in between.
    assert max(made.press(4.6, 1_000)) == 0.0
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("counts", ["50 Hz", "60 Hz", "noise"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [None, 1.0, 4.6], ids=["from the start", "1 N", "4.6 N"])
def test_an_open_input_that_hums_or_jumps_is_noticed_and_the_finger_released(
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
def test_a_sensor_dead_from_the_start_never_brings_more_than_5_n(rig: Any, stiffness_n_m: float, counts: float) -> None:
    made = rig(stiffness_n_m)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(5.0, 1_000)) <= (0.0 if counts else 5.0)


@pytest.mark.parametrize("counts", [100.0, 500.0])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_sensor_stuck_in_between_from_the_start_is_noticed_before_the_finger_is_touched(
    rig: Any, stiffness_n_m: float, counts: float
) -> None:
    made = rig(stiffness_n_m)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(5.0, 1_000)) == 0.0
    assert made.times_ms(ForceFault)[0] <= 300


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize(("from_n", "to_n", "most_n"), [(1.0, 3.0, 2.6), (3.0, 5.0, 5.0), (3.0, 0.0, 3.1)])
def test_a_sensor_that_freezes_is_noticed_when_the_platform_moves_on(
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
def test_above_the_end_of_its_table_a_device_is_not_asked_for_force(rig: Any, stiffness_n_m: float) -> None:
    table = GENERIC_CALIBRATION
    made = rig(stiffness_n_m, calibration=Calibration(table.counts[:7], table.forces_n[:7]))
    assert made.nano.max_force_n == 3.0
    assert 2.5 < max(made.press(5.0, 2_500)) <= 3.2
    assert not made.times_ms(ForceFault)


def test_a_table_that_reads_too_little_presses_too_hard_and_nobody_notices(rig: Any) -> None:
    table = GENERIC_CALIBRATION
    made = rig(calibration=Calibration(table.counts, tuple(0.8 * force_n for force_n in table.forces_n)))
    made.press(2.0, 2_000)
    assert made.felt_n[-1] == pytest.approx(2.0 / 0.8, rel=0.06)
    assert not made.times_ms(ForceFault)


@pytest.mark.parametrize(("blocked", "noticed"), [(1, False), (2, False), (3, True)])
def test_blocked_servos_press_no_harder_and_only_all_three_are_noticed(
    pressing: Any, blocked: int, noticed: bool
) -> None:
    made = pressing(force_n=2.0)
    plant = made.nano.plant
    made.nano.board.plant = Blocked(plant, blocked)
    assert max(made.press(4.5, 1_500)) <= 5.0
    assert bool(made.times_ms(ForceFault)) == noticed
    assert made.press(0.0, 1_000)[-1] == pytest.approx((0.0, 0.56, 2.02)[blocked - 1], abs=0.1)


class Blocked:
    """A plant whose first few servos do not move any more."""

    def __init__(self, plant: Any, servos: int) -> None:
        self._plant, self._servos = plant, servos

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def take_one(self, index: int, pulse_us: float) -> None:
        if index >= self._servos:
            self._plant.take_one(index, pulse_us)


def test_the_same_fault_twice_is_felt_the_same_to_the_bit(pressing: Any) -> None:
    def run(seed: int) -> tuple[list[float], list[Any], Reading | None]:
        made = pressing(seed=seed)
        made.nano.board.sensor = lambda counts, now_us: counts if now_us % 7_000 else 0.0
        made.stall(250)
        made.press(3.0, 500)
        return made.felt_n, made.events, made.fingertip.reading

    assert run(1) == run(1) != run(2)


def test_every_test_and_file_that_the_safety_document_names_is_there() -> None:
    root = Path(__file__).parents[2]
    document = (root / "docs" / "safety.md").read_text()
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", document)
    assert len(named) > 30
    texts = {path.name: path.read_text() for path in (root / "tests").rglob("test_*.py")}
    assert [name for file, name in named if f"def {name}(" not in texts.get(file, "")] == []
    files = re.findall(r"`((?:hapticnet|firmware)/\S+\.\w+)`", document)
    assert [file for file in files if not (root / file).is_file()] == []
