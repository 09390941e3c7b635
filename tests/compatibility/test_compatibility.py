"""What docs/refer/compatibility.md promises: frozen vectors of the wire, recordings and names."""

import copy
import json

import pytest

import hapticnet as hn
from tests.compatibility.freeze import FROZEN, MAIN_FILES, VERSIONS, api, broken_vectors, command_line, summary, wire

WIRE = json.loads((FROZEN / "wire.json").read_text())
RECORDINGS = [path.parent / name for path in sorted(FROZEN.glob("*/expected.json")) for name in MAIN_FILES]


def test_no_golden_vector_changes_without_another_version_of_the_wire():
    assert WIRE["versions"] == VERSIONS, (
        "the version of the wire has changed: state it in docs/refer/compatibility.md and CHANGELOG.md,"
        " then freeze its vectors: python -m tests.compatibility.freeze wire"
    )
    assert broken_vectors(WIRE, wire()) == [], (
        f"these golden vectors have changed, and peers of wire versions {VERSIONS} would no longer agree: undo that, or"
        " raise the version in hapticnet/protocol/wire.py (hapticnet/device/messages.py). New vectors go to the end"
    )


@pytest.mark.parametrize("name", WIRE["vectors"])
def test_a_changed_or_missing_vector_is_found_and_an_appended_one_is_not(name):
    now = copy.deepcopy(WIRE["vectors"])
    now[name].append("0123456789abcdef")
    assert broken_vectors(WIRE, now) == []
    now[name][0] = "0123456789abcdef"
    assert broken_vectors(WIRE, now) == [f"{name}, number 1"]
    del now[name]
    assert len(broken_vectors(WIRE, now)) == len(WIRE["vectors"][name])


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_recording_of_each_version_reads_as_it_did(path):
    wanted = json.loads((path.parent / "expected.json").read_text())[path.name]
    assert summary(path) == wanted, "what an earlier version has recorded must read the same; do not freeze it again"
    assert wanted["complete"]
    assert wanted["rows"] > 90
    assert wanted["largest_n"] > 1.0


def test_recordings_of_this_minor_version_are_frozen():
    minor = ".".join(hn.__version__.split(".")[:2])
    assert any(path.parent.name == minor for path in RECORDINGS), (
        f"a new minor version, {minor}: keep recordings of it: python -m tests.compatibility.freeze recordings"
    )


@pytest.mark.parametrize(("file", "lines"), [("python.txt", api), ("command_line.txt", command_line)])
def test_the_public_names_and_options_are_those_that_are_frozen(file, lines):
    frozen, now = (FROZEN / file).read_text().splitlines(), lines()
    gone, new = sorted(set(frozen) - set(now)), sorted(set(now) - set(frozen))
    said = "".join([*(f"\n- {line}" for line in gone), *(f"\n+ {line}" for line in new)])
    assert now == frozen, (
        f"what users call has changed:{said}\nIf what was right still is (only names, options, or parameters with a"
        " default at the end, were added), note it in CHANGELOG.md and run: python -m tests.compatibility.freeze names."
        " If not, 0.2.x cannot have it: keep what was there, and change it in 0.3 (docs/refer/compatibility.md)"
    )
