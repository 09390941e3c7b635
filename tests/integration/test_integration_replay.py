"""A recorded session is played again by processes."""

import numpy as np

from hapticnet.recordings.session.reading import read_session

PATIENCE_S = 30.0


def test_a_session_is_played_again_to_a_slave_and_without_one(start, tmp_path, slave):
    process, address = slave
    first, again, offline = tmp_path / "first.mcap", tmp_path / "again.mcap", tmp_path / "offline.mcap"
    quick = ("--rate", "500", "--duration", "1.5")
    master = start("master", "--connect", address, "--codec", "raw", *quick, "--record", str(first), "--json")
    assert master.process.wait(PATIENCE_S) == 0, master.said()

    # Its hand to the same slave: another session feels the same scene.
    replay = start("replay", str(first), "--connect", address, "--codec", "raw", "--record", str(again), "--json")
    assert replay.process.wait(PATIENCE_S) == 0, replay.said()
    assert replay.report()["scene"] == "paper:1"
    assert process.end() == 0

    # Its force, through a codec, without that slave.
    replay = start("replay", str(first), "--codec", "deadband", "--record", str(offline), "--json")
    assert replay.process.wait(PATIENCE_S) == 0, replay.said()
    report = replay.report()
    assert report["scene"] == "recording:first.mcap"
    assert report["received"]["by_kind"]["force"] < report["sent"]["by_kind"]["position"] / 3

    recorded = read_session(first).main
    for file in (again, offline):
        replayed = read_session(file).main
        assert np.ptp(replayed["position_m"]) > 0.5 * np.ptp(recorded["position_m"])
        assert replayed["held_n"].max() > 0.5 * recorded["held_n"].max() > 0.1
