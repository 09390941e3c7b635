"""`hapticnet stability`: the map, what it means, and what is refused."""

import json

import pytest

from tests.ready import ROOT

FEW = "--delays", "0ms,50ms", "--walls", "100,1000", "--jobs", "1"


def test_the_map_says_where_the_hand_swings_and_what_helps(run, tmp_path):
    file = tmp_path / "map.png"
    done = run("stability", *FEW, "--codec", "raw", "--plot", file)
    assert done.returncode == 0
    rows = [line.split() for line in done.stdout.splitlines() if line.lstrip().startswith(("0 ms", "50 ms"))]
    assert rows == [["0", "ms", "stable", "stable"], ["50", "ms", "stable", "thrown"]]
    assert (
        "At 50 ms this hand swings for ever against 1000 N/m. Without codec and coupling it would against 150 N/m"
        in done.stdout
    )
    assert "With --codec motion-predictive it holds 1 of these 1, and 1 feel as stiff as they are." in done.stdout
    assert "People begin to notice the delay of a damper from 15 ms on, of a spring from 36 ms on." in done.stdout
    assert file.read_bytes().startswith(b"\x89PNG")
    again = run("stability", *FEW, "--plot", file)
    assert (again.returncode, "exists; choose another file or add --overwrite" in again.stderr) == (2, True)


def test_a_scene_is_pressed_instead_of_walls_and_json_has_every_figure(run):
    done = run("stability", "--scene", "paper:1", "--delays", "5ms", "--hand", "finger,max-force=4,device-mass=0.05",
               "--loss", "5%", "--jitter", "1ms", "--codec", "motion-predictive", "--json")  # fmt: skip
    account = json.loads(done.stdout)
    (press,) = account["presses"]
    assert account["hand"] == "finger,max-force=4,device-mass=0.05"
    assert press["stable"]
    assert press["transparent"]
    assert press["stiffness_n_per_m"] is None
    assert press["largest_n"] <= 4.0
    assert account["verdict"] == ["This hand holds all of them, and 1 of 1 feel as stiff as they are."]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--hand", "fingr"), "unknown hand 'fingr' (did you mean 'finger'?)"),
        (("--hand", "arm,axes=2"), "omit axes and motion, because the hand presses on one axis"),
        (("--walls", "soft"), "--walls 'soft' must be stiffnesses in N/m, such as 100,500"),
        (("--walls", "100", "--scene", "paper"), "give one of them"),
        (("--walls", "0", "--delays", "0ms"), "stiffness_n_per_m is 0.0; it must be between"),
        (("--delays", "100"), '"100" is not a time such as 20ms'),
        (("--codec", "motion-predictiv"), "did you mean 'motion-predictive'?"),
        (("--coupling", "energy-bound"), "did you mean 'energy-bounded'?"),
        (("--scene", "papper"), "did you mean 'paper'?"),
        (("--scene", "phantom", "--delays", "0ms"), "a map presses on one axis"),
        (("--loss", "5 percent"), "is not a share such as 2%"),
        (("--delays", "100s"), "no session begins within 10 s over a round trip of 100 s"),
        (("--jitter", "5s", "--delays", "0s"), "over a round trip of 0 s with jitter=normal:5s,loss=0% each way"),
        (("--plot", "map.bmp"), "figure format is 'bmp'"),
    ],
)
def test_what_cannot_be_used_is_refused_in_a_sentence(run, options, message):
    done = run("stability", *options, "--jobs", "1")
    assert (done.returncode, message in done.stderr) == (2, True), done.stderr
    assert not (ROOT / "map.bmp").exists()
