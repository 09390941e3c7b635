"""The scene of bodies on the command line: shown, and compared on under a recorded hand."""

import json

import numpy as np
import pytest

from tests.cli.test_cli_errors import assert_one_line

HAND = ("--position-column", "x,y,z", "--position-scale", "0.001", "--start", "0.018,0,0")


@pytest.fixture
def hand(tmp_path):
    """Return a hand recorded in mm at 100 Hz, far from the phantom's origin."""
    t_s = np.arange(300) / 100
    columns = [t_s, 500 + 9 * np.sin(t_s), 100 + 12 * np.sin(2 * t_s), 8 * np.cos(t_s)]
    file = tmp_path / "hand.csv"
    np.savetxt(file, np.column_stack(columns), delimiter=",", header="t_s,x,y,z", comments="")
    return file


def test_scene_show_lists_the_bodies(run):
    account = json.loads(run("scene", "show", "phantom", "--json").stdout)
    assert account["axes"] == 3
    assert [body["name"] for body in account["body"]] == ["skin", "lump"]
    assert "static_friction" not in account["body"][1]


def test_compare_tries_codecs_on_a_recorded_hand_in_a_scene(run, hand):
    done = run("compare", hand, "--scene", "phantom", *HAND, "--codecs", "raw;deadband", "--multipliers", "1", "--json")
    account = json.loads(done.stdout)
    (recording,) = account["recordings"]
    assert (recording["name"], recording["axes"], recording["period_ms"]) == ("phantom, hand", 3, 1.0)
    raw, deadband = account["rows"]
    assert raw["exceed_jnd_fraction"] == deadband["exceed_jnd_fraction"] == 0.0
    assert raw["felt_created_share"] > 0.0


def test_compare_tries_codecs_on_a_scene_under_its_scripted_hand(run):
    arguments = ("--codecs", "deadband", "--multipliers", "1", "--json", "--seed", "3")
    account = json.loads(run("compare", "--scene", "phantom", *arguments).stdout)
    (recording,) = account["recordings"]
    assert (recording["name"], recording["axes"]) == ("phantom, scripted hand 3", 3)
    assert recording["peak_n"] > 2.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--start", "0,0,0"), "--start moves the positions of a TRACE in a --scene"),
        (("--scene", "phantom", "--force-column", "x"), "--force-column names a recorded force"),
        (("--scene", "phantom", "--position-column", "x,y,z", "--start", "1,b"), "start '1,b' must be one to three"),
    ],
)
def test_what_does_not_fit_together_is_told_in_one_line(run, hand, arguments, message):
    assert_one_line(run("compare", hand, *arguments), message)
