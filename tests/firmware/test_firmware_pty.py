"""The simulated Nano on a pseudo-terminal in real time; these tests assert no speed."""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticnet.device.messages import (
    Deframer,
    Flag,
    Hello,
    Identity,
    Message,
    SensorReading,
    Setpoint,
    Stream,
    decode,
    encode,
    frame,
)
from hapticnet.device.simulated import PlantSettings
from hapticnet.runtime.nano import BUILD_VARIABLE, MOST_CATCH_UP_US, Board, NanoPty

ROOT = Path(__file__).parents[2]
COMMAND = ["-m", "hapticnet", "device", "sim"]
PATIENCE_S = 20.0

Process = subprocess.Popen[str]


class Visitor:
    """A program that opens the pseudo-terminal like a file."""

    def __init__(self, path: str) -> None:
        self._line = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._deframer = Deframer()

    def say(self, message: Message) -> None:
        os.write(self._line, b"\0" + frame(encode(message)))

    def hears(self, wait_s: float = 0.0) -> list[Message]:
        select.select([self._line], [], [], wait_s)
        try:
            return [decode(body) for body in self._deframer.feed(os.read(self._line, 4096))]
        except BlockingIOError:
            return []

    def wait_for(self, kind: type[Message], said: Message) -> Any:
        """Repeat a message until it is answered by one of a kind, because booting firmware misses some."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            self.say(said)
            again = time.monotonic() + 0.5
            while time.monotonic() < again:
                for message in self.hears(0.1):
                    if isinstance(message, kind):
                        return message
        pytest.fail(f"no {kind.__name__} within {PATIENCE_S:g} s")

    def close(self) -> None:
        os.close(self._line)


@pytest.fixture
def start(simavr_files: tuple[Path, Path]) -> Iterator[Callable[..., Process]]:
    """Return a function that starts ``hapticnet device sim``."""
    running: list[Process] = []

    def run(*arguments: object) -> Process:
        running.append(
            subprocess.Popen(
                [sys.executable, *COMMAND, *map(str, arguments)],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                cwd=ROOT,
                env=os.environ | {"PYTHONPATH": str(ROOT), BUILD_VARIABLE: str(simavr_files[0].parent)},
            )
        )
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.communicate()


@pytest.fixture
def nano(simavr_files: tuple[Path, Path]) -> Iterator[NanoPty]:
    """A simulated Nano in this process, with the test's time."""
    board = Board(PlantSettings(), np.random.default_rng(1), build=simavr_files)
    with closing(NanoPty(board)) as made:
        yield made
    board.close()


def path_of(process: Process) -> str:
    assert process.stdout is not None
    path = process.stdout.readline().strip()
    assert Path(path).is_char_device(), process.communicate(timeout=PATIENCE_S)
    return path


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_any_program_can_open_close_and_reopen_it(start: Any, number: signal.Signals) -> None:
    process = start("--stiffness", "2", "--seed", "3")
    path = path_of(process)
    visitor = Visitor(path)
    identity = visitor.wait_for(Identity, Hello())
    first = visitor.wait_for(SensorReading, Stream(1))
    visitor.close()

    visitor = Visitor(path)
    again = visitor.wait_for(Identity, Hello())
    later = visitor.wait_for(SensorReading, Stream(1))
    assert again.boot_id == identity.boot_id == later.boot_id
    assert later.uptime_ms > first.uptime_ms
    deadline = time.monotonic() + PATIENCE_S
    while not any(isinstance(message, SensorReading) and message.adc > 0 for message in visitor.hears(0.01)):
        visitor.say(Setpoint(7, 2800, 2800, 2800))
        assert time.monotonic() < deadline, "the finger was never felt"
    visitor.close()

    process.send_signal(number)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    assert output == ""
    assert "finger of 2 N/mm" in errors


def test_a_finger_without_stiffness_is_refused(start: Any) -> None:
    process = start("--stiffness", "0")
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "finger stiffness is 0.0 N/m" in errors
    assert output == ""


def test_a_missing_build_is_refused_with_the_command_to_make_it(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, *COMMAND],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), BUILD_VARIABLE: str(tmp_path)},
    )
    assert process.returncode == 4
    assert "make simulator" in process.stderr


def play(nano: NanoPty, start_ms: int, end_ms: int) -> None:
    for ms in range(start_ms, end_ms):
        nano.advance(1_000 * ms)


def streaming(nano: NanoPty) -> Visitor:
    """Return a visitor that asked for a stream; 60 ms have passed."""
    play(nano, 0, 30)
    assert not nano.visited
    visitor = Visitor(nano.path)
    visitor.say(Hello())
    play(nano, 30, 40)
    visitor.say(Stream(1))
    play(nano, 40, 60)
    assert nano.visited
    return visitor


def test_a_new_visitor_does_not_get_output_left_by_the_last(nano: NanoPty) -> None:
    streaming(nano).close()
    play(nano, 60, 100)
    assert not nano.visited
    visitor = Visitor(nano.path)
    assert visitor.hears() == []
    play(nano, 100, 110)
    readings = visitor.hears()
    assert readings
    assert all(isinstance(reading, SensorReading) and reading.uptime_ms >= 98 for reading in readings)
    assert readings[0].flags & Flag.GREETED
    visitor.close()


def test_a_visitor_that_does_not_read_blocks_nothing(nano: NanoPty) -> None:
    visitor = streaming(nano)
    play(nano, 60, 2_000)
    heard = []
    for ms in range(2_000, 2_100):
        nano.advance(1_000 * ms)
        heard += visitor.hears()
    assert any(isinstance(message, SensorReading) and message.uptime_ms > 1_990 for message in heard)
    visitor.close()


def test_a_short_stall_is_made_up_for_and_a_long_one_in_part(nano: NanoPty) -> None:
    nano.advance(10**9)
    nano.advance(10**9 + 40_000)
    assert nano.lost_us == 0
    assert nano.board._cycle == pytest.approx(40_000 * 16, abs=20)
    nano.advance(10**9 + 1_040_000)
    assert nano.lost_us == 1_000_000 - MOST_CATCH_UP_US
    assert nano.board._cycle == pytest.approx((40_000 + MOST_CATCH_UP_US) * 16, abs=20)
    nano.advance(0)
    assert nano.board._cycle == pytest.approx((40_000 + MOST_CATCH_UP_US) * 16, abs=20)
