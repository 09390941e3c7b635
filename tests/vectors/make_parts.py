"""Write tests/vectors/parts.json: payloads of stimuli of several parts, and what a receiver applies.

Run ``python -m tests.vectors.make_parts`` after an intended change; the tests say whether it is needed.
"""

import json
from pathlib import Path

import numpy as np

from hapticnet.codec.registry import make_codec
from hapticnet.errors import PeerError
from hapticnet.parts import PartsLaw, parse_parts
from hapticnet.perception import WeberLaw
from tests.vectors.make_codecs import contact, decoder_after, signal

FILE = Path(__file__).with_name("parts.json")

NOTE = (
    "As codecs.json; 'parts' and 'thresholds' are those of the request. Forces are in N, torques in N·m, grips in N;"
    " positions in m, rotations in rad, openings in m. 'refused' must be refused at the end."
)
POSE = ("force:3", "torque:3", "grip:1")
FINGERS = ("force:2@thumb", "force:2@index")

CASES = [
    ("raw", {}, POSE, {}),
    ("deadband", {}, POSE, {}),
    ("deadband", {"step_n": 0.001}, POSE, {"torque": (0.1, 0.01), "grip": (0.1, 0.1)}),
    ("deadband", {}, FINGERS, {}),
    ("motion-predictive", {}, POSE, {}),
]


def samples_of(parts, number):
    """Return times, stimuli and positions; the parts change at times of their own."""
    one = contact if number == 4 else lambda axes, seed: signal(axes, seed)
    columns = [one(part.axes, 50 + number + index) for index, part in enumerate(parts)]
    t_us = columns[0][0]
    forces = np.hstack([np.roll(forces, 5 * index, 0) for index, (_, forces, _) in enumerate(columns)])
    return t_us, forces.tolist(), np.hstack([positions for _, _, positions in columns]).tolist()


def case(number, name, parameters, texts, thresholds):
    """Return one case; the third update is lost."""
    parts = parse_parts(texts)
    law = PartsLaw.of(parts, WeberLaw(), thresholds)
    codec = make_codec(name, law, parameters)
    encoder, decoder = codec.encoder(law.axes), codec.decoder(law.axes)
    samples, updates = [], 0
    for t_us, force, position in zip(*samples_of(parts, number), strict=True):
        payload = encoder.encode(t_us, tuple(force), tuple(position))
        arrives = None
        if payload is not None:
            updates += 1
            arrives = updates != 3
            if arrives:
                decoder.decode(t_us, payload)
        applied = decoder.reconstruct(t_us, tuple(position))
        samples.append([t_us, force, position, payload.hex() if payload else None, arrives, list(applied)])
    last = next(sample[3] for sample in reversed(samples) if sample[3])
    refused = ["", last[:-2], last + "00", "ff" + last[2:], last[: 2 + 2 * int(last[:2], 16)]]
    for payload in refused:
        try:
            decoder_after(codec, law.axes, samples).decode(samples[-1][0], bytes.fromhex(payload))
        except PeerError:
            continue
        raise AssertionError(f"{payload} is taken")
    return {
        "name": f"{name}, {' '.join(texts)} (case {number})",
        "codec": name,
        "parameters": parameters,
        "parts": list(texts),
        "thresholds": thresholds,
        "samples": samples,
        "refused": refused,
    }


def document():
    return {"note": NOTE, "cases": [case(number, *each) for number, each in enumerate(CASES)]}


if __name__ == "__main__":
    FILE.write_text(json.dumps(document(), indent=None, separators=(",", ":")) + "\n")
