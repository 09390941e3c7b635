"""A copy of the data as BIDS: the structure that the validator asks for, and no changed value."""

import csv
import dataclasses
import json
import re

import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.study.export import export
from hapticnet.study.rows import LimitsRow, OrderRow, header, to_line
from tests.study.made import rows

BIDS_NAME = re.compile(r"sub-(\w+)/ses-(\w+)/beh/sub-\1_ses-\2_task-(order|limits)_events\.(tsv|json)")
PSYCH_DS_NAME = re.compile(r"data/subject-\w+_session-\w+_task-(order|limits)_data\.csv")
TOP = {"dataset_description.json", "README.md"}


@pytest.fixture
def study(tmp_path):
    folder = tmp_path / "study"
    begun = OrderRow(event="begin", participant="01", session=1, onset_s=0.0, duration_s=0.0, observer="step-masking")
    for person in ("01", "02"):
        own = [row for row in rows(people=2) if row.participant == person]
        place = folder / f"sub-{person}" / "ses-1" / "order"
        place.mkdir(parents=True)
        first = [dataclasses.replace(begun, participant=person)]
        (place / "order.tsv").write_text(header(OrderRow) + "".join(map(to_line, [*first, *own])))
    pair = LimitsRow(
        event="trial", participant="01", session=1, onset_s=1.0, duration_s=2.5, reference_n=0.5, observer="literature"
    )
    (folder / "limits.tsv").write_text(header(LimitsRow) + to_line(pair))
    return folder


def tree(folder):
    return {str(file.relative_to(folder)): file for file in sorted(folder.rglob("*")) if file.is_file()}


def table(file, delimiter="\t"):
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines, delimiter=delimiter))


def test_bids_has_a_table_with_a_sidecar_for_each_session(study, tmp_path):
    before = tree(study)
    written = export(study, tmp_path / "bids", name="trial run", people="A. Author; B. Author")
    files = tree(tmp_path / "bids")
    assert set(files) == {str(file.relative_to(tmp_path / "bids")) for file in written}
    assert set(files) >= TOP | {"participants.tsv", "participants.json"}
    data = set(files) - TOP - {"participants.tsv", "participants.json"}
    assert len(data) == 6
    assert all(BIDS_NAME.fullmatch(name) for name in data)
    for name in data:
        if name.endswith(".tsv"):
            head = files[name].read_text().splitlines()[0].split("\t")
            assert head[:2] == ["onset", "duration"]
            assert all(re.fullmatch(r"[a-z0-9_]+", column) for column in head)
            described = json.loads(files[name.replace(".tsv", ".json")].read_text())
            assert set(head) <= set(described)
            assert all(described[column]["Description"] for column in head)
            assert described["onset"]["Units"] == "s"
            for row in table(files[name]):
                assert "" not in row.values()
                assert all(row[column] == "n/a" or float(row[column]) >= 0.0 for column in ("onset", "duration"))
    assert tree(study) == before


def test_bids_describes_the_data_set_and_says_that_it_is_simulated(study, tmp_path):
    export(study, tmp_path / "bids", name="trial run", people="A. Author; B. Author")
    described = json.loads((tmp_path / "bids" / "dataset_description.json").read_text())
    assert described["Name"] == "trial run (simulated)"
    assert described["Authors"] == ["A. Author", "B. Author"]
    assert re.fullmatch(r"1\.\d+\.\d+", described["BIDSVersion"])
    assert "SIMULATED: no person took part" in (tmp_path / "bids" / "README.md").read_text()
    people = table(tmp_path / "bids" / "participants.tsv")
    assert [row["participant_id"] for row in people] == ["sub-01", "sub-02"]
    assert all(row["simulated"] in ("literature", "step-masking") for row in people)


def test_no_value_changes_on_the_way_to_bids(study, tmp_path):
    export(study, tmp_path / "bids", name="x")
    before = table(study / "sub-02" / "ses-1" / "order" / "order.tsv")
    after = table(tmp_path / "bids/sub-02/ses-1/beh/sub-02_ses-1_task-order_events.tsv")
    assert len(before) == len(after)
    assert [sorted(row.values()) for row in before] == [sorted(row.values()) for row in after]


def test_data_of_people_are_not_called_simulated(tmp_path):
    study = tmp_path / "study"
    study.mkdir()
    (study / "order.tsv").write_text(header(OrderRow) + "".join(map(to_line, rows(people=1, simulated=False))))
    export(study, tmp_path / "bids", name="people")
    described = json.loads((tmp_path / "bids" / "dataset_description.json").read_text())
    assert described["Name"] == "people"
    assert "simulated" not in (tmp_path / "bids" / "README.md").read_text().lower()


def test_an_export_never_overwrites_and_needs_data(study, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("kept")
    with pytest.raises(SettingsError, match="is not empty; choose a new folder"):
        export(study, tmp_path / "full", name="x")
    (tmp_path / "none").mkdir()
    with pytest.raises(SettingsError, match="has no tables of a study"):
        export(tmp_path / "none", tmp_path / "new", name="x")
    with pytest.raises(FileError, match="no such folder"):
        export(tmp_path / "absent", tmp_path / "new", name="x")
    assert not (tmp_path / "new").exists()
