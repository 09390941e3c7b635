"""The demo's figures from what two nodes recorded in virtual time, in the paper's scene and in one of bodies."""

import pytest

import hapticnet as hn
from hapticnet.cli.demo import print_results
from hapticnet.experiment.analysis import CONDITIONS
from hapticnet.experiment.demo import FROM_MASTER, FROM_SLAVE, Played, draw_bytes_per_penetration, results
from hapticnet.experiment.signal_figure import draw_run
from hapticnet.scene.sources import find_scene

DELAYS = {"p50_us": 1.0, "p99_us": 1.0, "p99_9_us": 1.0}


def play(scene, seconds):
    """Return what two conditions left behind; the counts that only processes have are made up."""
    played = []
    for condition in CONDITIONS[:2]:
        link = hn.virtual_link(scene=scene, codec=condition.codec, seed=1)
        link.run(seconds=seconds)
        slave = dict.fromkeys(FROM_SLAVE, 0.1) | {"steps": 1000, "received": {"lost": 0}}
        slave["sent"] = {"by_kind": {}, "wire_bytes": 1000}
        master = dict.fromkeys(FROM_MASTER, 0) | {"received": {"lost": 0}, "round_trip": DELAYS, "lateness": DELAYS}
        played.append(Played(condition, slave, master, {}, link.slave_samples(), link.master_samples()))
    return played


@pytest.mark.parametrize(
    ("scene", "seconds", "counted"), [("paper:1", 5.0, "penetration"), ("phantom", 3.0, "contact")]
)
def test_a_scene_is_summed_up_by_what_happens_in_it(scene, seconds, counted, capsys, tmp_path):
    played = play(scene, seconds)
    none, one_jnd = rows = results(played, find_scene(scene))
    assert none["counted"] == counted
    assert none["penetrations"] == one_jnd["penetrations"] >= 1
    assert one_jnd["byte_reduction"] > 0.5
    for row in rows:
        link = row["felt_over_link"]
        assert link["delay_us"] == 25_000
        assert 0.05 < link["exceed_jnd_fraction"] < 0.9
        assert link["created_share"] > 0.05
        assert row["predicted_over_link"]["exceed_jnd_fraction"] < 0.7 * link["exceed_jnd_fraction"]
    print_results(rows)
    printed = capsys.readouterr().out
    assert f"bytes per {counted}" in printed
    assert "above 1 JND over 25 ms" in printed
    assert ("ordered right" in printed) == (counted == "penetration")
    draw_bytes_per_penetration(rows, tmp_path / "bytes.png")
    draw_run(played[1].slave_samples, played[1].master_samples, tmp_path / "run.png", codec="deadband, 1 JND")
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
