"""Numerical stability of every codec: on hard signals, through loss, and over runs of 1e8 samples.

Signals: the largest error in thresholds of the applied force, packets and payload, with a moving hand, with and without
the floor of Weber's law; and whether encoder and decoder agree to the bit at the end. Loss: the paper's scene through a
channel that loses updates and repairs them after 20 ms. Long runs: the streaming pair for ``--seconds``, and the
compiled deadband over 1e8 samples.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import cycle, repeat
from typing import Any

import numpy as np
import record
from codec_trials import PERIOD_US, force_codecs, hand_force, in_step, trials

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Codec, Encoding
from hapticnet.codec.recording import encode_array, encode_lossy, encode_streamed
from hapticnet.codec.registry import make_codec
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.compiled import fast_extra_installed
from hapticnet.experiment.comparison import REPAIR_US
from hapticnet.experiment.trials import Trial, paper_trial
from hapticnet.measure.metrics import error_report
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector

CODECS = force_codecs()

Row = dict[str, Any]

LAW = WeberLaw()
LAWS = {"floor": LAW, "no floor": WeberLaw(floor_n=0.0)}
SMALLEST_THRESHOLD_N = 1e-290
"""Smallest divisor, so that errors over a threshold of 0 stay finite."""

LOSSES = (0.0, 0.05, 0.1, 0.3)
BLOCK_SAMPLES = 100_000


def on_signals(samples: int, seed: int) -> list[Row]:
    """Return a row for every law, signal and codec."""
    named: dict[str, list[Trial]] = {}
    for trial in trials(samples, np.random.default_rng(seed)):
        named.setdefault(trial.name, []).append(trial)
    return [
        {"law": law_name, "signal": name, "codec": codec, **on_signal(each, make_codec(codec, law))}
        for law_name, law in LAWS.items()
        for name, each in named.items()
        for codec in CODECS
    ]


def on_signal(recordings: Sequence[Trial], codec: Codec) -> Row:
    """Return errors, packets and sizes of a codec on the recordings of one name."""
    encodings = [encode_array(codec, trial.t_us, trial.stimuli, trial.positions) for trial in recordings]
    sizes = np.concatenate([encoding.payload_bytes for encoding in encodings])
    errors = [in_thresholds(codec, *pair) for pair in zip(recordings, encodings, strict=True)]
    return {
        "samples": sum(len(trial.t_us) for trial in recordings),
        "packets": len(sizes),
        "payload_bytes_mean": float(sizes.mean()),
        "payload_bytes_max": int(sizes.max()),
        "max_error_thresholds": max(errors),
        "in_step": all(ends_in_step(codec, trial) for trial in recordings),
    }


def in_thresholds(codec: Codec, trial: Trial, encoding: Encoding) -> float:
    """Return the largest distance of the applied stimulus from the true one, in thresholds around the applied one."""
    thresholds = codec.law.thresholds_n(np.abs(encoding.decoded))
    return float(np.max(np.abs(trial.stimuli - encoding.decoded) / np.maximum(thresholds, SMALLEST_THRESHOLD_N)))


def ends_in_step(codec: Codec, trial: Trial) -> bool:
    """Tell whether encoder and decoder agree after a recording with a hand at rest."""
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    for t_us, (x,) in zip(trial.t_us.tolist(), trial.stimuli.tolist(), strict=True):
        payload = encoder.encode(t_us, (x,))
        if payload is not None:
            decoder.decode(t_us, payload)
    return in_step(encoder, decoder, codec.law, int(trial.t_us[-1]), float(trial.stimuli[-1, 0]))


def through_loss(codecs: Sequence[Codec], seeds: Sequence[int], insertions: int | None) -> list[Row]:
    """Return a row for every codec and share of updates lost, over the paper's scene of all seeds."""
    scenes = [paper_trial(seed, insertions=insertions) for seed in seeds]
    true = np.concatenate([scene.stimuli for scene in scenes])
    rows = []
    for codec in codecs:
        for loss in LOSSES:
            decoded, waits_ms, packets = [], [], 0
            for seed, scene in zip(seeds, scenes, strict=True):
                channel = np.random.default_rng([seed, round(100 * loss)])
                encoding, received = encode_lossy(
                    codec, scene.t_us, scene.stimuli, scene.positions, loss=loss, repair_us=REPAIR_US, rng=channel
                )
                decoded.append(encoding.decoded)
                waits_ms += recoveries_ms(scene.t_us.tolist(), encoding.sent.tolist(), set(received.tolist()))
                packets += len(encoding.sent)
            error = error_report(LAW, true, np.concatenate(decoded))
            rows.append(
                {
                    "codec": codec.name,
                    "loss": loss,
                    "packets": packets,
                    "exceed_jnd_fraction": error.exceed_jnd_fraction,
                    "max_error_n": error.max_error_n,
                    "recoveries": len(waits_ms),
                    "recovery_ms_median": statistics.median(waits_ms) if waits_ms else 0.0,
                    "recovery_ms_max": max(waits_ms, default=0.0),
                }
            )
    return rows


def recoveries_ms(t_us: Sequence[int], sent: Sequence[int], received: set[int]) -> list[float]:
    """Return the time from the first lost update to the next received one, for each such gap."""
    waits_ms = []
    since_us: int | None = None
    for index in sent:
        if index not in received:
            since_us = t_us[index] if since_us is None else since_us
        elif since_us is not None:
            waits_ms.append((t_us[index] - since_us) / 1e3)
            since_us = None
    return waits_ms


def force_blocks(seed: int) -> Iterator[FloatArray]:
    """Yield an endless force of a hand, through zero, with small blocks, and spikes that a running sum would keep."""
    rng = np.random.default_rng(seed)
    while True:
        force = hand_force(BLOCK_SAMPLES, rng) - rng.uniform(0.0, 3.0)
        force[rng.integers(0, BLOCK_SAMPLES, 5)] += 1e5
        yield force * rng.choice([1.0, 1.0, 1.0, 1e-3])


def hand_positions() -> Iterator[Vector]:
    """Return the endless positions of a hand that moves 2 cm in and out every 3 s, with rests."""
    way_m = 0.02 * np.clip(1.5 * np.sin(np.arange(0.0, 2.0 * np.pi, 2.0 * np.pi / 3000)), -1.0, 1.0)
    return cycle([(x,) for x in way_m.tolist()])


def stream_for(codec: Codec, seconds: float, most_samples: int, seed: int) -> Row:
    """Stream blocks for `seconds` or `most_samples`; check every sample's error, and for drift after each block."""
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    resting = codec.decoder(1)  # without motion, a passive codec applies what it holds
    encode, decode, reconstruct = encoder.encode, decoder.decode, decoder.reconstruct
    weber, floor_n = LAW.weber_fraction, LAW.floor_n
    where: Iterator[Vector | None] = hand_positions() if codec.needs_position else repeat(None)
    t_us = samples = packets = exceeding = out_of_step = 0
    ends_s = time.monotonic() + seconds
    for block in force_blocks(seed):
        for x, position in zip(block.tolist(), where, strict=False):
            t_us += PERIOD_US
            payload = encode(t_us, (x,), position)
            if payload is not None:
                packets += 1
                decode(t_us, payload)
                resting.decode(t_us, payload)
            (applied,) = reconstruct(t_us, position)
            error = abs(x - applied)
            exceeding += not (error <= floor_n or error <= weber * abs(applied))
        samples += len(block)
        out_of_step += not in_step(encoder, resting, LAW, t_us, x)
        if samples >= most_samples or time.monotonic() >= ends_s:
            break
    return long_row(codec, "streaming", samples, packets, exceeding, out_of_step)


def whole_array(samples: int, seed: int) -> Row:
    """Encode `samples` samples with the deadband in one call; a streaming pair must end in the same state."""
    codec = Deadband(law=LAW)
    stimuli = np.empty((samples, 1))
    blocks = force_blocks(seed)
    starts = range(0, samples, BLOCK_SAMPLES)
    for start in starts:
        end = min(start + BLOCK_SAMPLES, samples)
        stimuli[start:end, 0] = next(blocks)[: end - start]
    t_us = np.arange(samples, dtype=np.int64)
    encoding = encode_array(codec, t_us, stimuli)
    exceeding = 0
    for start in starts:
        held = encoding.decoded[start : start + BLOCK_SAMPLES]
        errors = np.abs(stimuli[start : start + BLOCK_SAMPLES] - held)
        exceeding += int(np.sum(~(errors <= LAW.thresholds_n(np.abs(held)))))
    # Just after a packet, a deadband depends on nothing older.
    last = int(encoding.sent[np.searchsorted(encoding.sent, max(samples - BLOCK_SAMPLES, 0))])
    streamed = encode_streamed(codec, t_us[last:], stimuli[last:])
    same = streamed.decoded.tobytes() == encoding.decoded[last:].tobytes()
    return long_row(codec, "whole array", samples, len(encoding.sent), exceeding, int(not same))


def long_row(codec: Codec, way: str, samples: int, packets: int, exceeding: int, out_of_step: int) -> Row:
    return {
        "codec": codec.name,
        "way": way,
        "samples": samples,
        "packets": packets,
        "samples_exceeding": exceeding,
        "times_out_of_step": out_of_step,
    }


def measure(arguments: argparse.Namespace) -> Row:
    """Return all results."""
    seed, seconds, samples = arguments.seed, arguments.seconds, arguments.samples
    if arguments.quick:
        arguments.seeds, seconds, samples = 1, 0.0, -(-samples // 100)
    codecs = [make_codec(name, LAW) for name in CODECS]
    runs = [stream_for(codec, seconds, samples, seed) for codec in codecs]
    if fast_extra_installed():
        runs.append(whole_array(samples, seed))
    signals = on_signals(200 if arguments.quick else 4000, seed)
    apart = [f"{row['codec']} on {row['signal']}, {row['law']}" for row in signals if not row["in_step"]]
    print(f"out of step at the end of a signal: {'; '.join(apart) or 'no codec'}", file=sys.stderr)
    return {
        "signals": signals,
        "loss": through_loss(codecs, range(seed, seed + arguments.seeds), 1 if arguments.quick else None),
        "long": runs,
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.0), default=10.0, help="longest stream of each codec")
    parser.add_argument(
        "--samples", type=record.within(1), default=10**8, help="samples of the whole-array run; limit of a stream"
    )
    parser.add_argument("--seeds", type=record.within(1), default=5, help="lossy channels")
    parser.add_argument("--quick", action="store_true", help="a hundredth of it all")
    unit = "as in each name; loss and exceed_jnd_fraction are fractions"
    record.run(parser, measure, unit=unit)


if __name__ == "__main__":
    main()
