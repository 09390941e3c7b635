import math

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.control.swing import SwingWatch
from hapticnet.measure.energy import energy_report
from hapticnet.perception import WeberLaw

LAW = WeberLaw()


def watch(force_n, position_m):
    """Return the observer after these ticks of 1 ms, and the ticks at which it saw a swing."""
    port, seen = SwingWatch(), []
    for t_ms, (force, at) in enumerate(zip(np.atleast_2d(force_n.T).T, np.atleast_2d(position_m.T).T, strict=True)):
        port.add(1000 * t_ms, tuple(force.tolist()), tuple(at.tolist()), LAW)
        if port.swings(1000 * t_ms):
            seen.append(t_ms)
    return port, seen


T_S = np.arange(4000) / 1000.0


def swing(rate_per_s, hz=3.0, late_s=0.025, axes=1):
    """A hand in a spring of 300 N/m, whose force is late, with a swing that grows at this rate."""
    position_m = 0.01 + 1e-4 * np.exp(rate_per_s * T_S) * np.sin(2.0 * math.pi * hz * T_S)
    force_n = 300.0 * np.interp(T_S - late_s, T_S, position_m)
    if axes == 1:
        return force_n, position_m
    way = np.array([0.6, 0.0, 0.8][:axes])
    return force_n[:, None] * way, position_m[:, None] * way


@pytest.mark.parametrize("axes", [1, 3])
def test_a_growing_swing_is_seen_while_it_is_small(axes):
    _, seen = watch(*swing(1.5, axes=axes))
    first_n = 300.0 * 1e-4 * math.exp(1.5e-3 * seen[0])
    assert first_n < 1.0
    assert seen[:900] == list(range(seen[0], seen[0] + 900))


@pytest.mark.parametrize(
    ("force_n", "position_m"),
    [
        swing(-1.5),
        swing(1.0, late_s=0.0),  # a true spring gives back no more than it took
        swing(1.0, hz=0.5),  # the hand's own motion
        swing(0.0),  # tremor, below two JND
        (np.zeros(4000), 0.01 * np.sin(20.0 * T_S)),
    ],
)
def test_what_is_no_swing_is_not_seen(force_n, position_m):
    assert watch(force_n, position_m)[1] == []


def test_its_energies_are_those_of_a_recording():
    rng = np.random.default_rng(3)
    position_m = 1e-3 * np.cumsum(rng.normal(size=4000))
    force_n = np.maximum(0.0, np.cumsum(rng.normal(size=4000)) * 0.1)
    port, _ = watch(force_n, position_m)
    work_j = force_n[:-1] * np.diff(position_m)
    report = energy_report(LAW, force_n[:, None], force_n[:, None], position_m[:, None])
    assert port.put_in_j == pytest.approx(work_j[work_j > 0.0].sum())
    assert port.given_back_j == pytest.approx(-work_j[work_j < 0.0].sum())
    assert port.created_j == pytest.approx(report.active_j, rel=0.02)


@pytest.mark.parametrize(
    ("operator", "delay_ms", "swings"),
    [(None, 50, False), ("hand:arm", 0, False), ("hand:arm", 25, True), ("hand:finger", 5, True)],
)
def test_over_a_link_only_a_hand_that_yields_to_a_late_force_swings(operator, delay_ms, swings, tmp_path):
    file = tmp_path / "wall.toml"
    wall = "name = 'wall'\nrest_position_m = 0.02\nstiffness_n_per_m = 300.0\nbreach_force_n = 500.0"
    file.write_text(f"name = 'wall'\n[[tissue]]\n{wall}\n")
    link = f"delay={delay_ms}ms"
    run = hn.virtual_link(scene=str(file), operator=operator, forward=link, feedback=link)
    run.run(seconds=6.0)
    ticks = run.master_samples()
    _, seen = watch(ticks["held_n"], ticks["position_m"])
    assert bool(seen) is swings
    if swings:  # before it is large
        assert ticks["held_n"][: seen[0]].max() < 4.0
        assert ticks["held_n"].max() > 20.0
