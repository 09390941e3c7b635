"""Speed of every codec, whole-array and streaming, beside plain C loops in the same run, and of a threshold sweep."""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import record
from codec_twins import Array, Loop, hand_m, load_twins, times_us

from hapticnet.codec import arrays
from hapticnet.codec import deadband as deadband_module
from hapticnet.codec.base import Codec
from hapticnet.codec.deadband import Deadband
from hapticnet.codec.registry import CODECS
from hapticnet.codec.sweep_thresholds import sweep_deadband
from hapticnet.compiled import fast_extra_installed
from hapticnet.experiment.paper_force import paper_recording
from hapticnet.perception import WeberLaw

SENT_FRACTIONS = (0.01, 0.1, 0.4)
STREAMED = 200_000
SWEPT_LAWS = 64
SWEPT = 1_000_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    samples, repetitions = arguments.samples, arguments.repetitions
    signals = {fraction: signal(samples, fraction, arguments.seed) for fraction in SENT_FRACTIONS}
    with tempfile.TemporaryDirectory() as folder:
        loops = load_twins(Path(folder))
        rows = [measure(Deadband(), stimuli, loops["deadband"], repetitions) for stimuli in signals.values()]
        codecs = [measure_codec(CODECS[name](), signals[0.1], loops.get(name), repetitions) for name in CODECS]
    swept = measure_sweep(signals[0.1][:SWEPT], repetitions)
    print(f"deadband over {samples:,} scalar samples, Msamples/s, best of {repetitions}\n")
    print(f"{'sent':>7}{'C loop':>9}{'fast extra':>12}{'ratio':>8}{'plain Python':>14}{'streaming':>11}")
    for row in rows:
        fast, ratio = row["fast"], row["fast"] / row["c"]
        print(f"{row['sent']:7.1%}{row['c']:9.0f}{fast:12.0f}{ratio:8.2f}{row['plain']:14.1f}{row['stream']:11.2f}")
    print("\nevery codec: ns a sample streaming (walk, paper's scene), Msamples/s whole-array (fast extra, C loop)\n")
    for row in codecs:
        fast, c = (f"{row[way]:9.0f}" if row[way] else f"{'–':>9}" for way in ("fast", "c"))
        print(f"{row['codec']:24}{row['walk_ns']:8.0f}{row['paper_ns']:8.0f}{fast}{c}")
    print(f"\n{SWEPT_LAWS} thresholds: {swept:.0f} M sample-parameters/s")
    if arguments.json:
        record.write(
            arguments.json,
            name="codec_speed",
            seed=arguments.seed,
            unit="Msamples/s; *_ns: ns per sample",
            repetitions=repetitions,
            results={
                "samples": samples,
                "rows": rows,
                "codecs": codecs,
                "sweep": {"laws": SWEPT_LAWS, "samples": min(samples, SWEPT), "m_sample_parameters_per_s": swept},
            },
        )


def signal(samples: int, sent: float, seed: int) -> Array:
    """Return a force between 0.5 and 4.5 N that wanders so fast that about `sent` of it leaves the dead zone."""
    step_n = {0.01: 0.0091, 0.1: 0.0365, 0.4: 0.105}[sent]
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, step_n, samples))
    folded: Array = np.abs(walk % 8.0 - 4.0) + 0.5
    return folded


def whole_array(codec: Codec, stimuli: Array, *, compile_above: int) -> int:
    deadband_module.COMPILE_ABOVE_SAMPLES = arrays.COMPILE_STREAM_ABOVE_SAMPLES = compile_above
    positions = hand_m(len(stimuli)) if codec.needs_position else None
    return len(codec.encode_array(times_us(len(stimuli)), stimuli, positions).sent)


def best(ways: dict[str, Callable[[], int]], samples: int, repetitions: int) -> tuple[dict[str, float], int]:
    """Return million samples a second of each way, measured in turns, and how many the last one sent."""
    taken = dict.fromkeys(ways, float("inf"))
    sent = 0
    for _ in range(repetitions):
        for name, way in ways.items():
            started = time.perf_counter()
            sent = way()
            taken[name] = min(taken[name], time.perf_counter() - started)
    return {name: samples / seconds / 1e6 for name, seconds in taken.items()}, sent


def measure(codec: Codec, stimuli: Array, c_loop: Loop, repetitions: int) -> dict[str, float]:
    """Return million samples a second of the deadband: C, compiled, plain Python and streaming."""
    ways = {
        "c": lambda: c_loop(stimuli),
        "plain": lambda: whole_array(codec, stimuli, compile_above=len(stimuli)),
    }
    if fast_extra_installed():
        ways["fast"] = lambda: whole_array(codec, stimuli, compile_above=0)
        ways["fast"]()  # compile, or load from the cache
    speed, sent = best(ways, len(stimuli), repetitions)
    streamed_ns = stream_ns(codec, stimuli[:STREAMED], np.zeros(min(len(stimuli), STREAMED)), repetitions)
    return {"sent": sent / len(stimuli), "fast": 0.0, **speed, "stream": 1e3 / streamed_ns}


def measure_codec(codec: Codec, stimuli: Array, c_loop: Loop | None, repetitions: int) -> dict[str, float | str]:
    """Return ns a sample of a codec's streaming pair, and whole-array speeds where it has a C twin."""
    scene = paper_recording(1)
    walked = stimuli[:STREAMED]
    speed: dict[str, float] = {}
    if c_loop is not None:
        ways = {"c": lambda: c_loop(stimuli)}
        if fast_extra_installed():
            ways["fast"] = lambda: whole_array(codec, stimuli, compile_above=0)
            sent = ways["fast"](), ways["c"]()
            # Roundings may part them for a sample; other constants or another rule would for many.
            assert abs(sent[0] - sent[1]) <= 1e-3 * sent[1] + 1.0, f"{codec.name} sends {sent[0]}, its C twin {sent[1]}"
        speed, _ = best(ways, len(stimuli), repetitions)
    return {
        "codec": codec.name,
        "walk_ns": stream_ns(codec, walked, hand_m(len(walked)), repetitions),
        "paper_ns": stream_ns(codec, scene.force_n[:, 0], scene.position_m[:, 0], repetitions),
        "fast": 0.0,
        "c": 0.0,
        **speed,
    }


def stream_ns(codec: Codec, stimuli: Array, positions: Array, repetitions: int) -> float:
    """Return ns a sample through encoder and decoder, one at a time, in plain Python."""
    samples = [
        (1000 * i, (x,), (p,)) for i, (x, p) in enumerate(zip(stimuli.tolist(), positions.tolist(), strict=True))
    ]
    fastest = float("inf")
    for _ in range(repetitions):
        encoder, decoder = codec.encoder(1), codec.decoder(1)
        encode, decode, reconstruct = encoder.encode, decoder.decode, decoder.reconstruct
        started = time.perf_counter()
        for t_us, stimulus, position in samples:
            payload = encode(t_us, stimulus, position)
            if payload is not None:
                decode(t_us, payload)
            reconstruct(t_us, position)
        fastest = min(fastest, time.perf_counter() - started)
    return 1e9 * fastest / len(samples)


def measure_sweep(stimuli: Array, repetitions: int) -> float:
    """Return million samples times laws a second."""
    laws = [WeberLaw(multiplier=multiplier) for multiplier in np.geomspace(0.25, 16.0, SWEPT_LAWS).tolist()]
    sweep_deadband(stimuli, laws)  # compile, or load from the cache
    speed, _ = best({"sweep": lambda: len(sweep_deadband(stimuli, laws).packets)}, len(stimuli), repetitions)
    return SWEPT_LAWS * speed["sweep"]


if __name__ == "__main__":
    main()
