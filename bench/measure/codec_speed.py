"""Measure the speed of every codec, compiled and streaming, beside plain C loops in the same run."""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import record
from codec_twins import EXACT, Array, Loop, hand_m, load_twins, times_us

from hapticnet.codec import recording
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import every_codec
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.compiled import fast_extra_installed
from hapticnet.experiment.paper_force import paper_recording

CODECS = every_codec()

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
        positions = hand_m(len(stimuli)) if stimuli.ndim == 1 else np.column_stack([hand_m(len(stimuli))] * 3)
    return len(recording.encode_array(codec, times_us(len(stimuli)), stimuli, positions).sent)


def best(ways: dict[str, Callable[[], int]], samples: int, repetitions: int) -> tuple[dict[str, float], int]:
    """Return million samples a second of each way, measured in turns, and the number that the last one sent."""
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
    """Return ns a sample of a codec's streaming pair, and whole-array speeds on one axis (beside C) and three axes."""
    scene = paper_recording(1)
    part = stimuli[: len(stimuli) // 4]
    if c_loop is not None and codec.name in EXACT:
        check_exact(codec, stimuli[:COMPARED], c_loop)
    three = np.column_stack([part, np.roll(part, len(part) // 3), -np.roll(part, len(part) // 2)])
    speed: dict[str, float] = {}
    ways: dict[str, Callable[[], int]] = {} if c_loop is None else {"c": lambda: len(c_loop(stimuli).sent)}
    if fast_extra_installed():
        ways["fast"] = lambda: whole_array(codec, stimuli)
        sent = {name: way() for name, way in ways.items()}
        # Rounding may change a few samples; another constant or rule would change many.
        assert "c" not in sent or abs(sent["fast"] - sent["c"]) <= 1e-3 * sent["c"] + 1.0, (
            f"{codec.name} sends {sent['fast']}, its C twin {sent['c']}"
        )
        whole_array(codec, three)
        speed["axes3"] = best({"axes3": lambda: whole_array(codec, three)}, len(three), repetitions)[0]["axes3"]
    if ways:
        speed |= best(ways, len(stimuli), repetitions)[0]
    walked = three[:STREAMED]
    return {
        "codec": codec.name,
        "walk_ns": stream_ns(codec, [stimuli[:STREAMED]], repetitions),
        "paper_ns": stream_ns(codec, [scene.force_n[:, 0]], repetitions, scene.position_m[:, 0]),
        "axes3_ns": stream_ns(codec, list(walked.T), 1),
        "fast": 0.0,
        "c": 0.0,
        "axes3": 0.0,
        **speed,
    }


def check_exact(codec: Codec, stimuli: Array, c_loop: Loop) -> None:
    """Check that a codec and its C twin send and apply the same, to the bit."""
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
