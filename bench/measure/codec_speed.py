"""Measure the speed of every codec, compiled and streaming, two of them beside plain C loops in the same run."""

import argparse
import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import record
from codec_trials import force_codecs

from hapticnet.codec import recording
from hapticnet.codec.base import Codec
from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.compiled import fast_extra_installed
from hapticnet.experiment.trials import paper_trial
from hapticnet.perception import WeberLaw

CODECS = force_codecs()
PEERS: Final = Path(__file__).parents[1] / "peers"
Array = npt.NDArray[np.float64]


class Encoded(NamedTuple):
    """Indices of the stimuli that were sent, and the stimulus applied at every sample."""

    sent: npt.NDArray[np.int64]
    decoded: Array


Loop = Callable[[Array], Encoded]

SENT_FRACTIONS = (0.01, 0.1, 0.4)
STREAMED = 200_000
COMPARED = 20_000


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    samples, repetitions = arguments.samples, arguments.repetitions
    signals = {fraction: signal(samples, fraction, arguments.seed) for fraction in SENT_FRACTIONS}
    with tempfile.TemporaryDirectory() as folder:
        loops = load_twins(Path(folder))
        rows = [measure_deadband(stimuli, loops["deadband"], repetitions) for stimuli in signals.values()]
        codecs = [measure_codec(CODECS[name](), signals[0.1], loops.get(name), repetitions) for name in CODECS]
    for row in codecs:
        array = f"{row['fast']:.1f} Msamples/s as an array, {row['c']:.1f} in C" if row["c"] else "no C loop"
        print(f"{row['codec']:22} {row['walk_ns']:6.0f} ns a sample in a stream, {array}", file=sys.stderr)
    return {
        "samples": samples,
        "rows": rows,
        "codecs": codecs,
    }


def load_twins(folder: Path) -> dict[str, Loop]:
    """Return the C loops by codec, compiled for this machine; like ours, they allocate their results."""
    law, curves = WeberLaw(), AdaptivePredictive()
    return {
        "deadband": _loop(folder, "deadband", law, law.multiplier),
        "adaptive-predictive": _loop(
            folder, "adaptive_predictive", law, curves.horizon_ms * 1e3, curves.window_ms * 1e3
        ),
    }


def _loop(folder: Path, name: str, law: WeberLaw, *settings: float) -> Loop:
    library = folder / f"{name}.so"
    command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", library, PEERS / f"{name}.c"]
    subprocess.run(command, check=True)
    function = ctypes.CDLL(str(library))[name]
    function.restype = ctypes.c_size_t
    pointer, double = ctypes.c_void_p, ctypes.c_double
    function.argtypes = [
        pointer, ctypes.c_size_t, pointer, pointer, double, double, *[double] * len(settings), pointer, pointer,
    ]  # fmt: skip

    def run(stimuli: Array) -> Encoded:
        samples = len(stimuli)
        decoded, sent = np.empty_like(stimuli), np.empty(samples, dtype=np.int64)
        times, hand = times_us(samples).ctypes.data, hand_m(samples).ctypes.data
        numbers = (law.weber_fraction, law.floor_n, *settings)
        count = function(stimuli.ctypes.data, samples, times, hand, *numbers, decoded.ctypes.data, sent.ctypes.data)
        return Encoded(sent[:count], decoded)

    return run


@cache
def times_us(samples: int) -> npt.NDArray[np.int64]:
    """Return a sample each millisecond; computed once, so that it is not measured."""
    return np.arange(samples, dtype=np.int64) * 1000


@cache
def hand_m(samples: int) -> Array:
    """Return the position of a moving hand at each sample; computed once as well."""
    position_m: Array = 0.02 * np.sin(np.arange(samples) * 0.002)
    return position_m


def signal(samples: int, sent: float, seed: int) -> Array:
    """Return a random walk between 0.5 and 4.5 N of which a deadband sends about the share `sent`."""
    step_n = {0.01: 0.0091, 0.1: 0.0365, 0.4: 0.105}[sent]
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, step_n, samples))
    folded: Array = np.abs(walk % 8.0 - 4.0) + 0.5
    return folded


def whole_array(codec: Codec, stimuli: Array, *, compile_above: int = 0) -> int:
    """Return how many stimuli of a recording a codec sends; recordings above `compile_above` samples are compiled."""
    recording.COMPILE_ABOVE_SAMPLES = compile_above
    positions = None
    if codec.needs_position:
        positions = hand_m(len(stimuli))
    return len(recording.encode_array(codec, times_us(len(stimuli)), stimuli, positions).sent)


def best(ways: dict[str, Callable[[], int]], samples: int, repetitions: int) -> tuple[dict[str, float], int]:
    """Return million samples a second of each function, measured in turns, and how many the last one sent."""
    taken = dict.fromkeys(ways, float("inf"))
    sent = 0
    for _ in range(repetitions):
        for name, way in ways.items():
            started = time.perf_counter()
            sent = way()
            taken[name] = min(taken[name], time.perf_counter() - started)
    return {name: samples / seconds / 1e6 for name, seconds in taken.items()}, sent


def measure_deadband(stimuli: Array, c_loop: Loop, repetitions: int) -> dict[str, float]:
    """Return million samples a second of the deadband: C, compiled, plain Python and streaming."""
    codec = Deadband()
    ways = {
        "c": lambda: len(c_loop(stimuli).sent),
        "plain": lambda: whole_array(codec, stimuli[:STREAMED], compile_above=len(stimuli)),
    }
    if fast_extra_installed():
        ways["fast"] = lambda: whole_array(codec, stimuli)
        ways["fast"]()  # compile, or load from the cache
    speed, sent = best(ways, len(stimuli), repetitions)
    speed["plain"] *= min(len(stimuli), STREAMED) / len(stimuli)
    streamed_ns = stream_ns(codec, [stimuli[:STREAMED]], repetitions)
    return {"sent": sent / len(stimuli), "fast": 0.0, **speed, "stream": 1e3 / streamed_ns}


def measure_codec(codec: Codec, stimuli: Array, c_loop: Loop | None, repetitions: int) -> dict[str, float | str]:
    """Return ns a sample of a codec's streaming pair on one and three axes, and its speed over a whole recording."""
    scene = paper_trial(1)
    assert scene.positions is not None
    if c_loop is not None:
        check_exact(codec, stimuli[:COMPARED], c_loop)
    speed: dict[str, float] = {}
    ways: dict[str, Callable[[], int]] = {} if c_loop is None else {"c": lambda: len(c_loop(stimuli).sent)}
    if fast_extra_installed():
        ways["fast"] = lambda: whole_array(codec, stimuli)
        ways["fast"]()  # compile, or load from the cache
    if ways:
        speed |= best(ways, len(stimuli), repetitions)[0]
    part = stimuli[:STREAMED]
    three = [part, np.roll(part, len(part) // 3), -np.roll(part, len(part) // 2)]
    return {
        "codec": codec.name,
        "walk_ns": stream_ns(codec, [stimuli[:STREAMED]], repetitions),
        "paper_ns": stream_ns(codec, [scene.stimuli[:, 0]], repetitions, scene.positions[:, 0]),
        "axes3_ns": stream_ns(codec, three, 1),
        "fast": 0.0,
        "c": 0.0,
        **speed,
    }


def check_exact(codec: Codec, stimuli: Array, c_loop: Loop) -> None:
    """Check that a codec and its C twin agree to the bit."""
    ours = recording.encode_streamed(codec, times_us(len(stimuli)), stimuli, hand_m(len(stimuli)))
    twin = c_loop(stimuli)
    assert np.array_equal(ours.sent, twin.sent), f"{codec.name} and its C twin send other samples"
    assert np.array_equal(ours.decoded[:, 0], twin.decoded), f"{codec.name} and its C twin apply other stimuli"


def stream_ns(codec: Codec, axes: list[Array], repetitions: int, position_m: Array | None = None) -> float:
    """Return ns a sample through encoder and decoder, one at a time, in plain Python."""
    where = hand_m(len(axes[0])) if position_m is None else position_m
    vectors = zip(*[axis.tolist() for axis in axes], strict=True)
    samples = [(1000 * i, x, (p,) * len(axes)) for i, (x, p) in enumerate(zip(vectors, where.tolist(), strict=True))]
    fastest = float("inf")
    for _ in range(repetitions):
        encoder, decoder = codec.encoder(len(axes)), codec.decoder(len(axes))
        encode, decode, reconstruct = encoder.encode, decoder.decode, decoder.reconstruct
        started = time.perf_counter()
        for t_us, stimulus, position in samples:
            payload = encode(t_us, stimulus, position)
            if payload is not None:
                decode(t_us, payload)
            reconstruct(t_us, position)
        fastest = min(fastest, time.perf_counter() - started)
    return 1e9 * fastest / len(samples)


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--samples", type=record.within(1), default=10_000_000)
    parser.add_argument("--repetitions", type=record.within(1), default=5)
    record.run(parser, measure, unit="Msamples/s; *_ns: ns per sample")


if __name__ == "__main__":
    main()
