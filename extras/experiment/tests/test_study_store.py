"""The table on disk: what a crash, a full disk, a second session or a strange file does to it."""

import asyncio
import errno
import json
import os
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import killed
import pytest
from conducted import DATE, GivenRig, WillingFront
from killed import settings_of

from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet_experiment import screens
from hapticnet_experiment.rows import LimitsRow, OrderRow, columns
from hapticnet_experiment.screens import ScreenKind
from hapticnet_experiment.session import check_number, conduct, open_session
from hapticnet_experiment.store import opened, read_rows, read_table, stored_schedule
from tests.cli.test_cli_errors import ROOT

NAME = "sub-03_ses-1_task-order_beh.tsv"
ROW = OrderRow(event="trial", participant="03", session=1, this_n=4, onset_s=1.25, order_answered="213", reason=None)


def open_table(folder, *, resume=True):
    return opened(folder / NAME, OrderRow, "{}\n", resume=resume)


def open_and_close(folder):
    with open_table(folder):
        pass


def test_what_is_stored_is_read_as_it_was_written(tmp_path):
    rows = [ROW, replace(ROW, this_n=5, reason="tab\tand\nline", peak_held_1_n=1.0 / 3.0, text="")]
    with open_table(tmp_path) as store:
        for row in rows:
            store.append(row)
    read = read_table(tmp_path / NAME, OrderRow)
    assert read[0] == ROW
    assert (read[1].reason, read[1].text) == ("tab and line", None)
    assert read[1].peak_held_1_n == pytest.approx(1.0 / 3.0, rel=1e-8)


def test_the_table_has_psychopys_names_and_each_column_is_described(tmp_path):
    with open_table(tmp_path) as store:
        store.append(ROW)
    header, line = (tmp_path / NAME).read_text().splitlines()
    names = header.split("\t")
    assert {"trials.thisN", "key_resp.rt", "key_resp.corr", "participant", "session"} <= set(names)
    cells = dict(zip(names, line.split("\t"), strict=True))
    assert (cells["trials.thisN"], cells["onset_s"], cells["key_resp.rt"]) == ("4", "1.25", "n/a")
    described = json.loads((tmp_path / NAME).with_suffix(".json").read_text())
    assert set(described) == set(names) == set(columns(OrderRow))
    assert described["peak_held_1_n"]["Units"] == "N"


@pytest.mark.parametrize("torn", ["trial\t03", "trial\t03\t1\t9", "\x00\x00", "trial\t03\xff"])
def test_a_torn_last_line_is_dropped_and_nothing_else(tmp_path, torn):
    with open_table(tmp_path) as store:
        store.append(ROW)
    path = tmp_path / NAME
    whole = path.read_bytes()
    path.write_bytes(whole + torn.encode("latin-1"))
    assert read_table(path, OrderRow) == [ROW]
    with open_table(tmp_path) as store:
        assert store.rows == [ROW]
        store.append(replace(ROW, this_n=5))
    assert path.read_bytes().startswith(whole)
    assert [row.this_n for row in read_table(path, OrderRow)] == [4, 5]


def test_a_session_is_begun_once_keeps_its_schedule_and_is_not_shared(tmp_path):
    with open_table(tmp_path, resume=False) as store:
        store.append(ROW)
        with pytest.raises(SettingsError, match="another process runs this session"):
            open_and_close(tmp_path)
    before = (tmp_path / NAME).read_bytes()
    with pytest.raises(SettingsError, match="continue it with --resume"), open_table(tmp_path, resume=False):
        pass
    with opened(tmp_path / NAME, OrderRow, "another", resume=True):  # the lock goes with the session
        pass
    assert (tmp_path / NAME).read_bytes() == before
    assert (tmp_path / "schedule.json").read_text() == "{}\n"


@pytest.mark.parametrize("fails", ["write", "short", "fsync"])
def test_a_full_disk_leaves_the_table_as_it_was_and_says_so_in_one_line(tmp_path, monkeypatch, fails):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write = os.write
    with open_table(tmp_path) as store:
        store.append(ROW)
        before = (tmp_path / NAME).read_bytes()
        with monkeypatch.context() as patch:
            if fails == "short":
                patch.setattr(os, "write", lambda file, data: write(file, data[:10]))
            else:
                patch.setattr(os, fails, full)
            with pytest.raises(FileError) as error:
                store.append(replace(ROW, this_n=5))
        assert "No space left on device; everything before it is safe, continue with --resume" in str(error.value)
        assert (tmp_path / NAME).read_bytes() == before
        store.append(replace(ROW, this_n=5))
    assert [row.this_n for row in read_table(tmp_path / NAME, OrderRow)] == [4, 5]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("\t4\t", "\tfour\t"), "line 2: column trials.thisN: 'four' is not a number"),
        (lambda text: text + "trial\t03\n", "line 3: the row has 2 cells"),
        (lambda text: text.replace("onset_s", "onset"), "written by another version"),
        (lambda text: text.replace("03", "\udcff"), "not UTF-8"),
    ],
)
def test_a_strange_table_is_refused_with_its_line_and_left_alone(tmp_path, change, words):
    with open_table(tmp_path) as store:
        store.append(ROW)
    path = tmp_path / NAME
    path.write_bytes(change(path.read_text()).encode("utf-8", "surrogateescape"))
    before = path.read_bytes()
    with pytest.raises(FileError, match=words):
        open_and_close(tmp_path)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("name", "use"),
    [
        (NAME, open_and_close),
        (NAME, lambda folder: read_table(folder / NAME, OrderRow)),
        (NAME, lambda folder: read_rows(folder, OrderRow)),
        (".lock", open_and_close),
        ("schedule.json", stored_schedule),
    ],
)
def test_a_pipe_in_the_place_of_a_sessions_file_is_refused_in_one_line(tmp_path, name, use):
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileError, match="is a pipe; expected a regular file"):
        use(tmp_path)


@pytest.mark.parametrize("name", [NAME, ".lock"])
def test_no_file_of_a_session_is_written_through_a_link(tmp_path, name):
    (tmp_path / "precious").write_text("torn")
    folder = tmp_path / "session"
    folder.mkdir()
    (folder / name).symlink_to(tmp_path / "precious")
    for temporary in (".schedule.json.part", f".schedule.json.{os.getpid()}.part"):
        (folder / temporary).symlink_to(tmp_path / "precious")
    with pytest.raises(FileError, match="is a link; expected a regular file"):
        open_and_close(folder)
    (folder / name).unlink()
    open_and_close(folder)
    assert (tmp_path / "precious").read_text() == "torn"
    assert (folder / "schedule.json").read_text() == "{}\n"


def test_a_table_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    with open_table(tmp_path) as store:
        store.append(ROW)
    monkeypatch.setattr("hapticnet_experiment.store.LARGEST_TABLE", 100)
    with pytest.raises(FileError, match="the limit is 100"):
        read_rows(tmp_path, OrderRow)


def test_a_number_in_two_spellings_is_one_participant(tmp_path):
    (tmp_path / "sub-03").mkdir()
    check_number(settings_of(tmp_path, 3))
    with pytest.raises(SettingsError, match="has participant 03, who has the same number"):
        check_number(replace(settings_of(tmp_path, 3), participant="3"))


def test_a_session_of_a_person_does_not_go_on_with_an_observer(tmp_path):
    settings = replace(settings_of(tmp_path, 3), resume=False)
    with open_session(settings, 0) as (flow, store):
        store.append(flow.take_rows()[0])
    for change, told in (
        ({"observer": "literature"}, "was begun by a person and can only"),
        ({"device": "another"}, "was begun with the device given, not another"),
    ):
        with pytest.raises(SettingsError, match=told), open_session(replace(settings, resume=True, **change), 0):
            pass
    with open_session(replace(settings, resume=True), 0) as (flow, _):
        assert [row.text for row in flow.take_rows()] == ["resumed"]


@pytest.mark.parametrize("number", [2, 3])
def test_a_participant_who_does_not_agree_ends_the_session_with_that_and_no_result(tmp_path, number):
    class Unwilling(WillingFront):
        async def key(self, flow):
            return screens.NO if flow.screen.kind is ScreenKind.CONSENT else screens.ENTER

    rig = GivenRig()
    for resume in (False, True):  # it does not ask again
        settings = replace(settings_of(tmp_path, number), resume=resume)
        with (
            pytest.raises(UnavailableError, match="did not agree to take part; nothing was asked or measured"),
            open_session(settings, 0) as (flow, store),
        ):
            asyncio.run(conduct(flow, rig, Unwilling(rig), store, date=lambda: DATE))
        assert [(row.event, row.reason) for row in store.rows] == [("begin", None), ("end", "no consent")]
    assert rig.activities == []


def test_sessions_killed_at_fifty_moments_lose_nothing_and_ask_nothing_twice(tmp_path):
    done = subprocess.run(
        [sys.executable, killed.__file__, str(tmp_path), "50", "1"],
        capture_output=True, text=True, check=False, cwd=ROOT, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    runs = 0
    for number in range(1, int(done.stdout) + 1):
        rows = read_table(settings_of(tmp_path, number).table, OrderRow if number % 2 else LimitsRow)
        stored = Counter((row.event, row.this_n) for row in rows)
        runs += stored["begin", None]
        asked = sorted(row.this_n for row in rows if row.event == "trial")
        assert asked == list(range(len(asked)))
        assert (stored["consent", None], stored["end", None]) == (1, 1)
        seen = Counter(tuple(line.split()) for line in (tmp_path / f"witness-{number}").read_text().splitlines())
        for (event, this_n), times in seen.items():
            assert stored[event, None if this_n == "None" else int(this_n)] >= times
    assert runs > 25, "most kills came before a session began"
