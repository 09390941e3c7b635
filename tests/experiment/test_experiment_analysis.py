from pathlib import Path

import numpy as np
import pytest

from hapticnet.experiment.analysis import CONDITIONS, bytes_per_penetration, felt_error, matched
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.scene.sources import paper_scene
from tests.recordings.session_cases import write_csv


def columns(force_n, breaches, datagram_bytes, position_m=None):
    return {
        "position_m": np.zeros(len(force_n)) if position_m is None else np.array(position_m, float),
        "force_n": np.array(force_n, float),
        "breaches": np.array(breaches, float),
        "datagram_bytes": np.array(datagram_bytes, float),
    }


@pytest.mark.parametrize(
    ("force_n", "breaches", "datagram_bytes", "each"),
    [
        # From the first touch to the breach, headers included.
        ([0, 0, 1, 2, 0, 0, 3, 4, 0, 0], [0, 0, 0, 0, 1, 1, 1, 1, 2, 2], [10, 10, 10, 0] * 2 + [10, 10], (76, 76)),
        # Breaches without a pause between them share nothing.
        ([0, 1, 1, 2, 0], [0, 0, 1, 1, 2], [10] * 5, (76, 76)),
        ([0, 1, 0], [0, 0, 0], [10] * 3, ()),
    ],
)
def test_a_penetration_costs_what_is_sent_from_touch_to_breach(force_n, breaches, datagram_bytes, each):
    report = bytes_per_penetration(columns(force_n, breaches, datagram_bytes))
    assert (report.each, report.mean, report.deviation) == (each, 76.0 if each else 0.0, 0.0)


def test_penetrations_are_kept_apart_by_tissue():
    slave = columns(
        force_n=[0, 1, 0, 2, 2, 0, 0, 3, 0],
        breaches=[0, 0, 1, 1, 1, 2, 2, 2, 3],
        datagram_bytes=[0, 10, 0, 10, 10, 10, 0, 10, 10],
        position_m=[0, 0.02, 0.025, 0.04, 0.043, 0.045, 0, 0.02, 0.025],
    )
    report = bytes_per_penetration(slave)
    assert report.each == (38, 3 * 38, 2 * 38)
    assert report.by_tissue(paper_scene(1).tissues) == [[38, 2 * 38], [3 * 38], []]


def test_contacts_are_paid_for_a_scene_that_nothing_breaches():
    slave = columns([0, 1, 2, 0, 3, 0, 1], [0] * 7, [10, 10, 0, 10, 10, 10, 10])
    assert bytes_per_penetration(slave, contacts=True).each == (38, 38, 38)
    sideways = {
        f"{name}_{axis}_{unit}": np.zeros(5) for name, unit in (("force", "n"), ("position", "m")) for axis in "xyz"
    }
    sideways["force_y_n"] = np.array([0.0, -1.0, -1.0, 0.0, 0.0])
    table = sideways | {"breaches": np.zeros(5), "datagram_bytes": np.full(5, 10.0)}
    assert bytes_per_penetration(table, contacts=True).each == (2 * 38,)


def test_every_condition_of_the_paper_penetrates_three_tissues_and_costs_less_than_the_one_before(loopback):
    means = []
    for condition in CONDITIONS:
        law = WeberLaw(multiplier=condition.multiplier)
        link = loopback(1, settings=MasterSettings(codec=condition.codec, law=law, record=True))
        link.run(5_000_000)
        report = bytes_per_penetration(link.slave.contexts[0].recording.table())
        assert len(report.each) == 3
        assert report.by_tissue(paper_scene(1).tissues) == [[spent] for spent in report.each]
        means.append(report.mean)
    assert means == sorted(means, reverse=True)


def test_what_is_felt_lags_by_the_round_trip_and_matches_across_the_wrap(loopback):
    start_us = (1 << 32) - 2_000_000
    quick = loopback(1, start_us=start_us)
    slow = loopback(1, forward="delay=20ms", feedback="delay=20ms", start_us=start_us)
    reports = []
    for link in (quick, slow):
        link.run(4_000_000)
        slave, master = link.slave.contexts[0].recording.table(), link.master.recording.table()
        assert len(matched(slave, master)[0]) == len(slave["t_us"])
        reports.append(felt_error(WeberLaw(), slave, master))
    # Over a perfect channel what is felt is one tick old; the slow one adds forty.
    assert 0.0 < reports[0].exceed_jnd_fraction < 0.05
    assert reports[1].exceed_jnd_fraction > 5 * reports[0].exceed_jnd_fraction
    assert reports[1].rmse_n > 2 * reports[0].rmse_n


@pytest.fixture(params=["raw", "line"])
def both_sides(request, loopback):
    """Return what both sides record over a network whose delay varies, where ticks are as late as on a real machine."""
    settings = MasterSettings(record=True, record_datagrams=True, positions=request.param)
    link = loopback(1, forward="wifi", feedback="wifi", settings=settings)
    rng = np.random.default_rng(1)
    for _ in range(4000):
        link._next_tick_us += int(rng.integers(-200, 200))
        link.run(1000)
    return link.slave.contexts[0].recording.table(), link.master.recording.table()


def test_each_row_of_a_slave_has_its_tick_however_few_positions_are_sent(both_sides):
    slave, master = both_sides
    at_slave, at_master = matched(slave, master)
    assert len(at_slave) > 0.9 * len(np.unique(slave["t_us"]))
    assert len(set(at_master.tolist())) == len(at_master)
    assert abs(slave["t_us"][at_slave] - master["t_us"][at_master]).max() <= 600
    distance_m = abs(slave["position_m"][at_slave] - master["position_m"][at_master])
    assert distance_m.max() < 0.002, "the tool was there"


def test_the_example_of_the_documentation_joins_all_rows(both_sides, tmp_path, monkeypatch):
    slave, master = both_sides
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recordings").mkdir()
    for file, columns in (("run.csv", master), ("recordings/master-0a1b2c3d.csv", slave)):
        write_csv(tmp_path / file, columns | {"t_us": columns["t_us"].astype(np.int64)})
    page = (Path(__file__).parents[2] / "docs" / "use" / "recordings.md").read_text()
    ((code),) = [block.split("```")[0] for block in page.split("```python\n")[1:]]
    names = {}
    exec(compile(code, "recordings.md", "exec"), names)  # noqa: S102 - our own page
    at_slave, at_master = matched(slave, master)
    assert len(names["both"]) >= len(at_slave)
    own_n = master["held_n"][at_master] - slave["force_n"][at_slave]
    assert np.sqrt((names["error"] ** 2).mean()) == pytest.approx(np.sqrt((own_n**2).mean()), rel=0.02)
