"""What a scene makes vibrate: touches, breaches and textures, and nothing where nothing is declared."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from hapticnet.errors import SettingsError
from hapticnet.samples import PositionSample
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Plane, Tissue
from hapticnet.scene.sources import find_scene, find_source, make_scene

RATE_HZ = 2800.0
TISSUE = {"name": "t", "rest_position_m": 0.01, "stiffness_n_per_m": 400.0, "breach_force_n": 2.0}
RINGS = {"ring_hz": 200.0, "ring_decay_per_s": 80.0, "touch_per_s": 100.0, "breach_m_s2": 12.0}
PLANE = {"name": "p", "point_m": (0.0, 0.0), "inward": (1.0, 0.0), "stiffness_n_per_m": 300.0}


def walk(scene, places_m, *, speed=0.05):
    """Step a scene along straight lines between places, 1 ms a step; return the time of the last step [µs]."""
    t_us = 0
    for start, end in itertools.pairwise(places_m):
        start, end = np.atleast_1d(start), np.atleast_1d(end)
        steps = max(1, round(np.linalg.norm(end - start) / speed / 1e-3))
        for step in range(1, steps + 1):
            t_us += 1000
            scene.step(PositionSample(t_us, tuple((start + (end - start) * step / steps).tolist())))
    return t_us


def heard(scene, start_us, count=280):
    return np.array(scene.vibration(start_us, count, RATE_HZ))


def frequency_hz(samples):
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 8192))
    return np.fft.rfftfreq(8192, 1.0 / RATE_HZ)[spectrum.argmax()]


def test_a_touch_rings_in_proportion_to_its_speed():
    peaks = []
    for speed in (0.02, 0.04, 0.08):
        scene = Scene([Tissue(**TISSUE, **RINGS)])
        end_us = walk(scene, [0.008, 0.0102], speed=speed)
        samples = heard(scene, end_us - 20_000)
        peaks.append(np.abs(samples).max())
        assert frequency_hz(samples) == pytest.approx(200.0, abs=15.0)
    assert peaks[1] / peaks[0] == pytest.approx(2.0, rel=0.05)
    assert peaks[2] / peaks[0] == pytest.approx(4.0, rel=0.05)
    assert peaks[0] == pytest.approx(0.02 * 100.0 * np.exp(-80.0 / 800.0), rel=0.05)


def test_a_breach_rings_as_a_decaying_sinusoid_and_ends():
    scene = Scene([Tissue(**TISSUE, **RINGS | {"touch_per_s": 0.0})])
    end_us = walk(scene, [0.008, 0.0149])
    assert scene.breaches == 0
    assert scene.vibration(end_us - 10_000, 28, RATE_HZ) is None
    begins_us = end_us + 1000
    for step in range(1, 20):
        scene.step(PositionSample(end_us + 1000 * step, (0.0149 + 5e-5 * step,)))
        if not scene.breaches:
            begins_us += 1000
    assert scene.breaches == 1
    times_s = np.arange(140) / RATE_HZ
    expected = 12.0 * np.exp(-80.0 * times_s) * np.sin(2.0 * np.pi * 200.0 * times_s)
    assert heard(scene, begins_us, 140) == pytest.approx(expected)
    assert heard(scene, begins_us - 10_000, 28).tolist() == [0.0] * 28, "it begins with the breach"
    assert scene.vibration(begins_us + 200_000, 28, RATE_HZ) is None


@pytest.mark.parametrize("speed", [0.05, 0.1])
def test_a_texture_is_felt_at_speed_over_wavelength_while_the_tool_slides(speed):
    scene = BodyScene([Plane(**PLANE, texture_m=0.5e-3, texture_per_s=20.0)])
    end_us = walk(scene, [(0.002, 0.0), (0.002, 0.02)], speed=speed)
    samples = heard(scene, end_us - 110_000)
    assert frequency_hz(samples) == pytest.approx(speed / 0.5e-3, rel=0.05)
    assert 0.8 * 20.0 * speed < np.abs(samples).max() < 2.1 * 20.0 * speed
    for step in range(1, 40):
        scene.step(PositionSample(end_us + 1000 * step, (0.002, 0.02)))
    assert scene.vibration(end_us + 10_000, 28, RATE_HZ) is None, "at rest"


def test_a_tap_on_a_body_rings():
    scene = BodyScene([Plane(**PLANE, ring_hz=300.0, ring_decay_per_s=90.0, touch_per_s=300.0)])
    end_us = walk(scene, [(-0.002, 0.0), (0.0005, 0.0)], speed=0.05)
    samples = heard(scene, end_us - 30_000)
    assert frequency_hz(samples) == pytest.approx(300.0, abs=20.0)
    assert np.abs(samples).max() == pytest.approx(0.05 * 300.0 * np.exp(-90.0 / 1200.0), rel=0.1)


@pytest.mark.parametrize("name", ["paper", "example-viscous", "phantom"])
def test_scenes_that_declare_no_vibration_have_none(name):
    assert make_scene(find_scene(name)).vibration is None


def test_rings_change_no_force_and_copies_ring_not():
    settings = find_scene("membranes")
    ringing = make_scene(settings)
    silent = Scene([replace(each, ring_hz=0.0) for each in settings.tissues])
    for step in range(600):
        sample = PositionSample(1000 * step, (1e-4 * step,))
        assert ringing.step(sample) == silent.step(sample)
    assert ringing.breaches == 2
    copy = ringing.copy()
    assert copy.vibration is None
    copy.step(PositionSample(700_000, (0.0,)))


def test_a_source_tells_whether_its_scenes_vibrate():
    for name, vibrates in (("membranes", True), ("paper", False)):
        source = find_source(name)
        source.prepare()
        assert source.vibrates is vibrates


@pytest.mark.parametrize(
    ("key", "value"), [("ring_hz", 1001.0), ("ring_hz", 0.5), ("ring_decay_per_s", 0.0), ("breach_m_s2", 1001.0)]
)
def test_values_out_of_range_are_refused(key, value):
    with pytest.raises(SettingsError, match=f"tissue 't': {key}"):
        Tissue(**TISSUE, **{key: value})
    with pytest.raises(SettingsError, match="texture_m"):
        Plane(**PLANE, texture_m=0.2)


def test_a_needle_that_begins_in_a_tissue_strikes_nothing():
    scene = Scene([Tissue(**TISSUE, **RINGS)])
    for _ in range(2):
        for step in range(1, 30):
            scene.step(PositionSample(1000 * step, (0.012,)))
        assert scene.vibration(10_000, 28, RATE_HZ) is None
        scene.reset()
