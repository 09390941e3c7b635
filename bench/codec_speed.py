"""Whole-array and streaming speed of the deadband, beside a plain C loop in the same run."""

import argparse
import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import record

from hapticnet.codec import deadband as deadband_module
from hapticnet.codec.arrays import fast_extra_installed
from hapticnet.codec.deadband import Deadband
from hapticnet.perception import WeberLaw

PEERS = Path(__file__).parent / "peers"
SENT_FRACTIONS = (0.01, 0.1, 0.4)
STREAMED = 200_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    codec = Deadband(law=WeberLaw())
    with tempfile.TemporaryDirectory() as folder:
        c_loop = load_c(Path(folder))
        rows = [
            measure(codec, signal(arguments.samples, fraction, arguments.seed), c_loop, arguments.repetitions)
            for fraction in SENT_FRACTIONS
        ]
    print(f"deadband over {arguments.samples:,} scalar samples, Msamples/s, best of {arguments.repetitions}\n")
    print(f"{'sent':>7}{'C loop':>9}{'fast extra':>12}{'ratio':>8}{'plain Python':>14}{'streaming':>11}")
    for row in rows:
        fast, ratio = row["fast"], row["fast"] / row["c"] if row["fast"] else 0.0
        print(f"{row['sent']:7.1%}{row['c']:9.0f}{fast:12.0f}{ratio:8.2f}{row['plain']:14.1f}{row['stream']:11.2f}")
    if arguments.json:
        record.write(
            arguments.json,
            name="codec_speed",
            seed=arguments.seed,
            unit="Msamples/s",
            repetitions=arguments.repetitions,
            results={"samples": arguments.samples, "rows": rows},
        )


def signal(samples: int, sent: float, seed: int) -> npt.NDArray[np.float64]:
    """Return a force between 0.5 and 4.5 N that wanders so fast that about `sent` of it leaves the dead zone."""
    step_n = {0.01: 0.0091, 0.1: 0.0365, 0.4: 0.105}[sent]
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, step_n, samples))
    folded: npt.NDArray[np.float64] = np.abs(walk % 8.0 - 4.0) + 0.5
    return folded


def load_c(folder: Path) -> Callable[[npt.NDArray[np.float64]], int]:
    """Return the C loop, compiled for this machine, as a function that allocates what it returns, as ours does."""
    library = folder / "deadband.so"
    subprocess.run(["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", library, PEERS / "deadband.c"], check=True)
    function = ctypes.CDLL(str(library)).deadband
    function.restype = ctypes.c_size_t
    law = WeberLaw()

    def run(stimuli: npt.NDArray[np.float64]) -> int:
        decoded = np.empty_like(stimuli)
        sent = np.empty(len(stimuli), dtype=np.int64)
        count = function(
            stimuli.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(len(stimuli)),
            *(ctypes.c_double(value) for value in (law.weber_fraction, law.floor_n, law.multiplier)),
            decoded.ctypes.data_as(ctypes.c_void_p),
            sent.ctypes.data_as(ctypes.c_void_p),
        )
        return int(count)

    return run


def measure(
    codec: Deadband, stimuli: npt.NDArray[np.float64], c_loop: Callable[..., int], repetitions: int
) -> dict[str, float]:
    """Return million samples a second of each way, measured in turns."""
    t_us = np.arange(len(stimuli), dtype=np.int64) * 1000
    times: dict[str, list[float]] = {"c": [], "fast": [], "plain": []}

    def array(compile_above: int) -> int:
        deadband_module.COMPILE_ABOVE_SAMPLES = compile_above
        return len(codec.encode_array(t_us, stimuli).sent)

    ways: dict[str, Callable[[], int]] = {"c": lambda: c_loop(stimuli), "plain": lambda: array(len(stimuli))}
    if fast_extra_installed():
        ways["fast"] = lambda: array(0)
        array(0)  # compile, or load from the cache
    sent = 0
    for _ in range(repetitions):
        for name, way in ways.items():
            started = time.perf_counter()
            sent = way()
            times[name].append(time.perf_counter() - started)
    speed = {name: len(stimuli) / min(taken) / 1e6 if taken else 0.0 for name, taken in times.items()}
    return {"sent": sent / len(stimuli), **speed, "stream": stream(codec, stimuli[:STREAMED], repetitions)}


def stream(codec: Deadband, stimuli: npt.NDArray[np.float64], repetitions: int) -> float:
    """Return million samples a second through encoder and decoder, one at a time."""
    vectors = [(value,) for value in stimuli.tolist()]
    best = float("inf")
    for _ in range(repetitions):
        encoder, decoder = codec.encoder(1), codec.decoder(1)
        started = time.perf_counter()
        for vector in vectors:
            payload = encoder.encode(0, vector)
            if payload is not None:
                decoder.decode(0, payload)
            decoder.reconstruct(0)
        best = min(best, time.perf_counter() - started)
    return len(vectors) / best / 1e6


if __name__ == "__main__":
    main()
