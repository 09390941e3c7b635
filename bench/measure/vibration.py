"""Vibration beside force: rate against distortion, what loss costs, how soon a breach is felt, and the time of a frame.

The signals are made, because measured ones may not be passed on: textures under a tool that slides and strikes that
ring (`hapticnet.scene.vibration`), and noise in a band, as autoregressive models of textures give it.
"""

import argparse
import itertools
import math
import time

import numpy as np
import record

import hapticnet as hn
from hapticnet.codec.vibration import FRAME, RATE_HZ, WEBER, VibrationCodec
from hapticnet.samples import PositionSample
from hapticnet.scene.vibration import Texture, Vibrations

BITS = 16  # of a sample that is not compressed, as in the literature
COARSER = (0, 2, 4)
LOSSES = (0.0, 0.05, 0.2)
DELAYS_MS = (0, 25, 50)


def texture(speed: float, wavelength_m: float, gain_per_s: float, seconds: float) -> np.ndarray:
    """Return what a tool feels that slides at a speed [m/s]."""
    made = Texture(wavelength_m, gain_per_s)
    parts = []
    for start_us in range(0, round(seconds * 1e6), 10_000):
        for step in range(11):
            made.slide(start_us + 1000 * step, 1e-3 * speed * (step > 0))
        part = made.samples(start_us, FRAME, float(RATE_HZ))
        parts.append(np.zeros(FRAME) if part is None else part)
    return np.concatenate(parts)


def noise(rng: np.random.Generator, peak_hz: float, amplitude: float, seconds: float) -> np.ndarray:
    """Return the output of an autoregressive model with one resonance, of this standard deviation."""
    turn, pole = 2.0 * math.pi * peak_hz / RATE_HZ, 0.92
    driven, made = rng.normal(size=round(seconds * RATE_HZ)), []
    one = two = 0.0
    for each in driven:
        one, two = each + 2.0 * pole * math.cos(turn) * one - pole * pole * two, one
        made.append(one)
    scaled: np.ndarray = np.array(made) * (amplitude / float(np.std(made)))
    return scaled


def strikes(rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Return strikes on rubber, wood and metal, three a second."""
    made = Vibrations()
    parts = []
    for start_us in range(0, round(seconds * 1e6), 10_000):
        if rng.random() < 0.03:
            hz, decay = [(60.0, 60.0), (150.0, 80.0), (300.0, 90.0)][int(rng.integers(3))]
            made.strike(start_us + int(rng.integers(10_000)), float(rng.uniform(2.0, 15.0)), hz, decay)
        part = made.samples(start_us, FRAME, float(RATE_HZ))
        parts.append(np.zeros(FRAME) if part is None else np.array(part))
    return np.concatenate(parts)


def signals(rng: np.random.Generator, seconds: float) -> dict[str, np.ndarray]:
    """Return the signals [m/s²] at 2800 Hz by their names."""
    return {
        "fine texture": texture(0.1, 0.4e-3, 20.0, seconds),
        "coarse texture": texture(0.08, 1.2e-3, 40.0, seconds),
        "noise, 2 m/s²": noise(rng, 220.0, 2.0, seconds),
        "noise, 10 m/s²": noise(rng, 150.0, 10.0, seconds),
        "strikes": strikes(rng, seconds),
    }


def decibels(signal: float, error: float) -> float | None:
    """Return a ratio of energies in dB; None if there is no error."""
    return 10.0 * math.log10(signal / error) if error else None


def rate_and_distortion(name: str, samples: np.ndarray, coarser: int) -> dict[str, object]:
    """Return rate and distortion of a signal at a coarseness of the quantiser."""
    codec = VibrationCodec()
    frames = samples[: len(samples) // FRAME * FRAME].reshape(-1, FRAME)
    size = sent = unfelt = 0
    level = wrong = energy = error = 0.0
    for frame in frames:
        payload = codec.encode(frame.tolist(), coarser=coarser)
        off = (np.zeros(FRAME) if payload is None else codec.decode(payload)) - frame
        sent += payload is not None
        size += 0 if payload is None else len(payload)
        own, missed = codec.level(frame), codec.level(off)
        unfelt += missed <= max(1.0, WEBER * own)
        level, wrong = level + own**2, wrong + missed**2
        energy, error = energy + float(frame @ frame), error + float(off @ off)
    seconds = len(frames) * FRAME / RATE_HZ
    return {
        "signal": name,
        "coarser": coarser,
        "frames_share": sent / len(frames),
        "kbit_per_s": 8e-3 * size / seconds,
        "bytes_per_frame": size / max(sent, 1),
        "compression": BITS / 8 * frames.size / max(size, 1),
        "snr_db": decibels(energy, error),
        "felt_snr_db": decibels(level, wrong),
        "unfelt_share": unfelt / len(frames),
    }


class Slider:
    """A scene whose texture passes under the tool, whatever it does."""

    axes = 1

    def __init__(self, samples: np.ndarray) -> None:
        self._samples = samples

    def step(self, _sample: PositionSample) -> float:
        """Return no force."""
        return 0.0

    def vibration(self, start_us: int, samples: int, rate_hz: float) -> np.ndarray:
        """Return the part of the signal that begins at a time."""
        begin = round(1e-6 * start_us * rate_hz) % (len(self._samples) - samples)
        return self._samples[begin : begin + samples]


def over_loss(samples: np.ndarray, loss: float, seconds: float, seed: int) -> dict[str, object]:
    """Return what arrives of a texture over a link with 25 ms each way and loss in both directions."""
    channel = f"delay=25ms,loss={loss}"
    link = hn.virtual_link(scene=Slider(samples), vibration=True, forward=channel, feedback=channel, seed=seed)
    link.run(seconds=seconds)
    report = link.report()
    sent, played = report.slave["vibration"], report.master["vibration"]
    return {
        "loss": loss,
        "frames": sent["frames"],
        "arrived_share": report.master["received"]["by_kind"]["vibration"] / sent["frames"],
        "played_share": played["frames"] / sent["frames"],
        "late": played["late"],
        "wait_ms": played["wait_ms"],
    }


def onset(delay_ms: int, seed: int) -> dict[str, float]:
    """Return how long after a breach, at the slave's scene, its vibration is played, and how strong it is."""
    channel = f"delay={delay_ms}ms"
    link = hn.virtual_link(scene="membranes", vibration=True, forward=channel, feedback=channel, seed=seed)
    link.run(seconds=8.0)
    steps, played = link.slave_samples(), link.vibration_samples()
    (broken, *_) = np.flatnonzero(np.diff(steps["breaches"])) + 1
    felt = (played["t_us"] >= steps["answered_us"][broken]) & (np.abs(played["felt_m_s2"]) > 1.0)
    return {
        "delay_ms": delay_ms,
        "after_breach_ms": 1e-3 * float(played["t_us"][felt][0] - steps["answered_us"][broken]),
        "true_peak_m_s2": 8.0,
        "felt_peak_m_s2": float(np.abs(played["felt_m_s2"][felt][:100]).max()),
    }


def cost(samples: np.ndarray) -> dict[str, float]:
    """Return the time of a frame [µs of cpu]."""
    codec = VibrationCodec()
    frames = [each.tolist() for each in samples[: len(samples) // FRAME * FRAME].reshape(-1, FRAME)]
    began = time.perf_counter()
    payloads = [codec.encode(frame) for frame in frames]
    encoded = time.perf_counter()
    for payload in payloads:
        if payload is not None:
            codec.decode(payload)
    decoded = time.perf_counter()
    each = 1e6 / len(frames)
    return {"encode_cpu_us": each * (encoded - began), "decode_cpu_us": each * (decoded - encoded)}


def measure(arguments: argparse.Namespace) -> dict[str, object]:
    """Measure all of it."""
    made = signals(np.random.default_rng(arguments.seed), arguments.seconds)
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    busy = made["noise, 2 m/s²"]
    return {
        "rows": [rate_and_distortion(name, made[name], coarser) for name, coarser in itertools.product(made, COARSER)],
        "loss": [over_loss(busy, loss, arguments.seconds, seed) for loss in LOSSES for seed in seeds],
        "onset": [onset(delay_ms, seed) for delay_ms in DELAYS_MS for seed in seeds],
        **cost(busy),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(1.0), default=20.0, help="length of each signal")
    parser.add_argument("--seeds", type=record.within(1), default=3, help="hands and links")
    record.run(parser, measure, unit="as in each name; compression over 16 bits at 2800 Hz")


if __name__ == "__main__":
    main()
