"""A line of a log in each of its forms."""

import json
import os

import pytest

from hapticnet.runtime.log_lines import Form, Level, LogLine, is_journal

LINE = LogLine(time_s=1_763_799_470.1234, level=Level.WARNING, who="master", text="link „stale“", event="LinkStale")


@pytest.mark.parametrize(
    ("form", "text"),
    [
        (Form.PLAIN, "master: warning: link „stale“\n"),
        (Form.STAMPED, "2025-11-22T08:17:50.123Z warning master: link „stale“\n"),
        (Form.JOURNAL, "<4>master: link „stale“\n"),
    ],
)
def test_a_line_for_people(form, text):
    assert LINE.write(form) == text


def test_a_line_for_programs_is_one_json_object():
    text = LINE.write(Form.JSON)
    assert text.count("\n") == 1
    assert json.loads(text) == {
        "time": "2025-11-22T08:17:50.123Z",
        "level": "warning",
        "source": "master",
        "message": "link „stale“",
        "event": "LinkStale",
    }


def test_the_journal_is_recognised_by_the_file_it_gave_us(tmp_path):
    with (tmp_path / "stderr").open("w") as stream:
        status = os.fstat(stream.fileno())
        named = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        assert is_journal(named, stream.fileno())
        assert not is_journal({}, stream.fileno())
        assert not is_journal({"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino + 1}"}, stream.fileno())
    assert not is_journal(named, -1)
