"""Messages reach a reader in order, and a reader who pauses keeps nobody waiting."""

import contextlib
import fcntl
import io
import logging
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from hapticnet.errors import FileError
from hapticnet.runtime import nonblocking_log as log_module
from hapticnet.runtime.nonblocking_log import (
    MOST_AT_ONCE,
    STDERR,
    Form,
    Level,
    LogLine,
    NonblockingLog,
    is_journal,
    write_watched,
)
from hapticnet.runtime.system import start_background
from tests.ready import fill


@dataclass
class Pipe:
    reader: int
    writer: io.TextIOWrapper

    def fill(self) -> int:
        """Fill the pipe; return how much it holds."""
        return fill(self.writer.fileno())

    def close_reader(self) -> None:
        nowhere = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nowhere, self.reader)
        os.close(nowhere)

    def read(self) -> str:
        os.set_blocking(self.reader, False)
        try:
            return os.read(self.reader, 1 << 20).decode().lstrip(".")
        except BlockingIOError:
            return ""


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    with os.fdopen(writer, "w") as stream:
        yield Pipe(reader, stream)
        os.close(reader)


@pytest.fixture
def log(pipe) -> NonblockingLog:
    made = NonblockingLog(lambda: pipe.writer)
    made.start()
    return made


def test_lines_arrive_in_order_and_the_status_line_stays_below_them(pipe, log):
    log.line(LogLine("one", who="x"))
    log.drain()
    log.status("x: 1 s")
    log.drain()
    log.line(LogLine("two", who="x"))
    log.drain()
    log.status("")
    log.drain()
    assert pipe.read() == "x: one\n\r\x1b[2Kx: 1 s\r\x1b[2Kx: two\n"


def test_a_full_pipe_keeps_nobody_waiting_and_loses_no_line_once_it_is_read(pipe, log):
    pipe.fill()
    for number in range(50):
        log.line(LogLine(str(number), who="x"))
        log.status(f"status {number}")
    assert not log.drain()
    assert pipe.read() == ""
    said = ""
    while "x: 49\n" not in said:
        said += pipe.read()
    assert "status 49" in said
    lines = [line.rpartition("x: ")[2] for line in said.splitlines() if line]
    assert [line for line in lines if line.isdigit()] == [str(number) for number in range(50)]
    assert said.count("status") <= 2, "only the newest status is worth showing"


def test_what_exceeds_the_rate_is_counted_and_told_in_one_line(pipe, log, monkeypatch):
    monkeypatch.setattr(log_module, "now_us", lambda: 0)
    for number in range(MOST_AT_ONCE + 1234):
        log.line(LogLine(str(number), who="x"))
    log.drain()
    lines = pipe.read().splitlines()
    assert lines == [*(f"x: {number}" for number in range(MOST_AT_ONCE)), "x: warning: … 1,234 lines left out"]
    assert log.left_out == 1234


def test_what_waits_for_a_reader_is_bounded(pipe, log, monkeypatch):
    monkeypatch.setattr(log_module, "MOST_WAITING", 20)
    pipe.fill()
    for number in range(100):
        log.line(LogLine(str(number), who="x"))
    assert 75 <= log.left_out <= 80
    log.line(LogLine("the error", who="x"), needed=True)
    said = ""
    while "left out" not in said:
        said += pipe.read()
    assert "x: the error\n" in said


def test_only_the_first_wait_for_a_reader_who_does_not_come_takes_time(pipe, log, monkeypatch):
    pipe.fill()
    log.line(LogLine("unread", who="x"))
    assert not log.drain()
    monkeypatch.setattr(log_module, "PARTING_S", 3600.0)
    assert not log.drain()


@pytest.mark.parametrize("started", [False, True])
def test_a_reader_who_has_gone_ends_nothing(pipe, started):
    log = NonblockingLog(lambda: pipe.writer)
    if started:
        log.start()
    pipe.close_reader()
    log.line(LogLine("unread", who="x"))
    assert log.drain()
    log.line(LogLine("unread", who="x"))
    assert log.drain()


@pytest.mark.parametrize("stream", [None, io.StringIO()])
def test_a_process_without_stderr_or_with_one_of_its_own(stream):
    log = NonblockingLog(lambda: stream)
    log.start()
    log.line(LogLine("grüße", who="x"))
    assert log.drain()
    assert stream is None or stream.getvalue() == "x: grüße\n"


def test_a_background_thread_never_runs_under_real_time_scheduling():
    """Where SCHED_FIFO is not permitted, this tests only that the thread runs."""
    policies = []

    def start() -> None:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        start_background(lambda: policies.append(os.sched_getscheduler(0)), "test").join()

    starter = threading.Thread(target=start)  # so that this thread's own scheduling stays as it is
    starter.start()
    starter.join()
    assert policies == [os.SCHED_OTHER]


def test_what_the_loop_reports_goes_the_same_way(monkeypatch):
    said = []
    monkeypatch.setattr(STDERR, "line", said.append)
    log_module._LogHandler().emit(logging.LogRecord("asyncio", logging.ERROR, "", 0, "it %s", ("broke",), None))
    assert [(line.who, line.text, line.level) for line in said] == [("asyncio", "it broke", Level.ERROR)]


def test_a_report_that_is_read_slowly_is_complete(pipe):
    text = "".join(f"{number}\n" for number in range(5000))
    read = []

    def work() -> None:
        os.set_blocking(pipe.reader, True)
        while sum(map(len, read)) < len(text):
            read.append(os.read(pipe.reader, 100))

    reader = threading.Thread(target=work)
    reader.start()
    write_watched(pipe.writer, text, stall_s=60.0)
    reader.join()
    assert b"".join(read).decode() == text


def test_a_report_that_nobody_reads_is_given_up(pipe):
    with pytest.raises(FileError, match="not being read"):
        write_watched(pipe.writer, "x" * 10_000, stall_s=0.01)
    pipe.close_reader()
    with pytest.raises(BrokenPipeError):
        write_watched(pipe.writer, "x" * 10_000, stall_s=60.0)


LINE = LogLine("link „stale“", "master", Level.WARNING, time_s=1_763_799_470.1234)


def test_a_line_has_the_form_that_its_reader_expects():
    assert LINE.write(Form.PLAIN) == "master: warning: link „stale“\n"
    assert LINE.write(Form.STAMPED) == "2025-11-22T08:17:50.123Z warning master: link „stale“\n"
    assert LINE.write(Form.JOURNAL) == "<4>master: link „stale“\n"
    assert LogLine("\x1b[2Kgone", "master").write(Form.PLAIN) == "master: ?[2Kgone\n"


def test_the_journal_is_recognised_by_the_file_it_gave_us(tmp_path):
    with (tmp_path / "stderr").open("w") as stream:
        status = os.fstat(stream.fileno())
        named = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        assert is_journal(named, stream.fileno())
        assert not is_journal({}, stream.fileno())
        assert not is_journal({"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino + 1}"}, stream.fileno())
    assert not is_journal(named, -1)
