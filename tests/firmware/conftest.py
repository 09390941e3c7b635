"""Fixtures for the firmware: its core on the host and its ELF in a simulated controller."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hapticnet.device.calibration import Calibration
from hapticnet.device.messages import Deframer, Hello, Message, decode, encode, frame
from hapticnet.device.simulated import Finger, PlantSettings
from hapticnet.device.wired import WiredDevice
from hapticnet.runtime.nano import CYCLES_PER_US, Disturbance, Simavr, SimulatedNano, Step
from tests.firmware.rig import FOUND_AND_PRESSED_MS, Rig


class Pulse(NamedTuple):
    """One servo pulse, as measured at the pin [µs]."""

    servo: int
    start_us: float
    width_us: float

    @property
    def end_us(self) -> float:
        return self.start_us + self.width_us


class Core:
    """The core in a native process under sanitizers; an error they find ends it and fails the test."""

    def __init__(self, shell: Path) -> None:
        self._process = subprocess.Popen([shell], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __call__(self, *words: object) -> str:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(" ".join(map(str, words)) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line.endswith("\n"), f"the core ended on {words[0]}"
        return line.strip()

    def send(self, now_ms: int, message: Message) -> list[Message]:
        return self.receive(now_ms, frame(encode(message)))

    def receive(self, now_ms: int, data: bytes) -> list[Message]:
        return self._messages(self("receive", now_ms, data.hex()))

    def tick(self, now_ms: int, adc: int = 0) -> list[Message]:
        return self._messages(self("tick", now_ms, adc))

    def frame(self, now_ms: int) -> list[int]:
        return [int(ticks) for ticks in self("frame", now_ms).split()]

    def close(self) -> int:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()
        return self._process.wait()

    @staticmethod
    def _messages(answer: str) -> list[Message]:
        return [decode(body) for body in Deframer().feed(bytes.fromhex(answer))]


class Nano:
    """The ELF in simavr, with its output and its pulses."""

    BOOT_US = 20_000

    def __init__(self, harness: Path, elf: Path) -> None:
        self.simavr = Simavr(harness, elf)
        self.deframer = Deframer()
        self.messages: list[Message] = []
        self.pulses: list[Pulse] = []
        self.sent = bytearray()
        self.now_us = 0.0
        self._rises_us = [0.0, 0.0, 0.0]

    def advance(self, duration_us: int, *messages: Message, data: bytes = b"", millivolts: float = 0.0) -> Step:
        data += b"".join(frame(encode(message)) for message in messages)
        step = self.simavr.advance(duration_us, millivolts=millivolts, data=data)
        self.sent += step.sent
        self.messages += [decode(body) for body in self.deframer.feed(step.sent)]
        for cycle, servo, level in step.edges:
            at_us = cycle / CYCLES_PER_US
            if level:
                self._rises_us[servo] = at_us
            elif self._rises_us[servo]:  # simavr also reports the initial level of the pins
                self.pulses.append(Pulse(servo, self._rises_us[servo], at_us - self._rises_us[servo]))
        self.now_us = step.cycle / CYCLES_PER_US
        return step

    def boot_and_greet(self) -> None:
        self.advance(self.BOOT_US)
        self.advance(5_000, Hello())

    def of_kind(self, kind: type[Message]) -> list[Message]:
        return [message for message in self.messages if isinstance(message, kind)]


@pytest.fixture
def core(make_firmware: Callable[..., Path], tool_is_missing: Callable[[str], None]) -> Iterator[Core]:
    for tool in ("make", "gcc"):
        if shutil.which(tool) is None:
            tool_is_missing(f"{tool} is missing, so the firmware's core cannot be built")
    running = Core(make_firmware("native") / "shell")
    yield running
    assert running.close() == 0


@pytest.fixture
def nano(request: pytest.FixtureRequest, make_firmware: Callable[..., Path]) -> Iterator[Callable[..., Nano]]:
    """Return a factory of simulated Nanos for an ELF."""
    request.getfixturevalue("needs_toolchain")
    running: list[Nano] = []

    def make(*, target: str = "firmware", elf: str = "firmware.elf") -> Nano:
        harness = make_firmware("sim") / "harness"
        running.append(Nano(harness, make_firmware(target) / elf))
        return running[-1]

    yield make
    for each in running:
        each.simavr.close()


@pytest.fixture
def simulated(simavr_files: tuple[Path, Path]) -> Iterator[Callable[..., SimulatedNano]]:
    """Return a factory of simulated Nanos for the settings of the plant, a seed and a disturbance."""
    running: list[SimulatedNano] = []

    def make(
        settings: PlantSettings | None = None,
        *,
        seed: int = 1,
        build: tuple[Path, Path] = simavr_files,
        wired: WiredDevice | None = None,
        **disturbance: Any,
    ) -> SimulatedNano:
        rng, disturbed = np.random.default_rng(seed), Disturbance(**disturbance)
        running.append(SimulatedNano(settings or PlantSettings(), rng, build=build, wired=wired, disturbance=disturbed))
        return running[-1]

    yield make
    for each in running:
        each.close()


@pytest.fixture
def rig(simavr_files: tuple[Path, Path], simulated: Any, make_firmware: Callable[..., Path]) -> Callable[..., Rig]:
    """Return a factory of rigs for a finger's stiffness and other settings."""

    def make(
        stiffness_n_m: float = 1000.0, *, hanging: bool = False, calibration: Calibration | None = None, **others: Any
    ) -> Rig:
        elf = make_firmware("test-firmware") / "hanging.elf" if hanging else simavr_files[1]
        build, wired = (simavr_files[0], elf), WiredDevice(calibration) if calibration else None
        settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
        return Rig(simulated(settings, build=build, wired=wired, **others), build)

    return make


@pytest.fixture
def pressing(rig: Callable[..., Rig]) -> Callable[..., Rig]:
    """Return a factory of rigs that press the finger with 3 N or another force."""

    def make(stiffness_n_m: float = 1000.0, *, force_n: float = 3.0, **others: Any) -> Rig:
        made = rig(stiffness_n_m, **others)
        made.press(force_n, FOUND_AND_PRESSED_MS)
        assert made.felt_n[-1] == pytest.approx(force_n, rel=0.1, abs=0.15)
        return made

    return make
