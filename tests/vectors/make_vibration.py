"""Write tests/vectors/vibration.json: frames of vibration, their payloads, and what a receiver plays.

Run ``python -m tests.vectors.make_vibration`` after an intended change. It follows docs/refer/payloads.md with math
alone and imports nothing of hapticnet.
"""

import json
import math
from pathlib import Path

FILE = Path(__file__).with_name("vibration.json")

NOTE = (
    "Frames of vibration. 'samples' are 28 accelerations in m/s² at 2800 Hz; 'payload' is what a sender may make of"
    " them for this threshold in m/s² (another scale is its own choice), null if nothing is felt; 'played' is what a"
    " receiver makes of the payload, to 1e-9. Each of 'refused' must be refused."
)
SIZE = 28
WEBER = 0.2


def step(order, threshold, scale):
    """Return the step of a coefficient."""
    return math.sqrt(6.0) * threshold * max(1.0, 50.0 * order / 250.0) ** 4 * 2.0 ** (scale / 2)


def wave(order, place):
    """Return the value of a function of the transform at a sample."""
    return math.sqrt((1 if order == 0 else 2) / SIZE) * math.cos(math.pi / SIZE * order * (place + 0.5))


def encoded(samples, threshold):
    """Return scale and numbers; None if nothing is felt."""
    coefficients = [sum(wave(order, at) * each for at, each in enumerate(samples)) for order in range(SIZE)]
    felt = [math.sqrt(SIZE / 12.0) * step(order, threshold, 0) for order in range(SIZE)]
    level = math.hypot(*(each / by for each, by in zip(coefficients, felt, strict=True)))
    if level < 1.0:
        return None
    scale = max(0, math.floor(2.0 * math.log2(WEBER * level)))
    numbers = [round(each / step(order, threshold, scale)) for order, each in enumerate(coefficients)]
    while numbers and not numbers[-1]:
        numbers.pop()
    return (scale, numbers) if numbers else None


def packed(scale, numbers):
    """Return a payload as bytes."""
    folded = [2 * each if each >= 0 else -2 * each - 1 for each in numbers]
    lengths = [sum((each >> rice) + 1 + rice for each in folded) for rice in range(16)]
    rice = lengths.index(min(lengths))
    bits = f"{scale:07b}{rice:04b}{len(numbers):05b}"
    for each in folded:
        bits += "1" * (each >> rice) + "0" + (f"{each % (1 << rice):0{rice}b}" if rice else "")
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[at : at + 8], 2) for at in range(0, len(bits), 8))


def played(scale, numbers, threshold):
    """Return the samples of numbers."""
    values = [each * step(order, threshold, scale) for order, each in enumerate(numbers)]
    sums = [sum(wave(order, at) * each for order, each in enumerate(values)) for at in range(SIZE)]
    return [min(max(each, -1000.0), 1000.0) for each in sums]


def sine(amplitude, frequency, decay=0.0):
    times = [at / 2800.0 for at in range(SIZE)]
    return [round(amplitude * math.exp(-decay * t) * math.sin(2.0 * math.pi * frequency * t), 6) for t in times]


def noise(amplitude):
    """Return numbers of a small generator, of no chance."""
    made, state = [], 12345
    for _ in range(SIZE):
        state = state * 1103515245 + 12345 & 0x7FFFFFFF
        made.append(round(amplitude * (state / 0x3FFFFFFF - 1.0), 6))
    return made


CASES = [
    ("nothing", [0.0] * SIZE, 0.1),
    ("too weak to be felt", sine(0.05, 250.0), 0.1),
    ("the same, of a more sensitive person", sine(0.05, 250.0), 0.02),
    ("just felt", sine(0.2, 100.0), 0.1),
    ("strong", sine(20.0, 250.0), 0.1),
    ("a breach", sine(15.0, 180.0, 80.0), 0.1),
    ("1 kHz", sine(300.0, 1000.0), 0.1),
    ("noise", noise(4.0), 0.1),
    ("as strong as can be", [1000.0, -1000.0] * (SIZE // 2), 0.001),
    ("a slow push", [2.3] * SIZE, 0.1),
]
REFUSED = [
    ("nothing", ""),
    ("no number", "0001"),
    ("count 0", "000000"),
    ("count 29", "003d00000000"),
    ("ends within its ones", "0001ff"),
    ("ends within its lower bits", "00a1ff"),
    ("a last number of 0", "000100"),
    ("a byte too many", "00018000"),
    ("a bit too many", "000181"),
    ("115 bytes", "0001" + "ff" * 112 + "00"),
]


def document():
    frames = []
    for name, samples, threshold in CASES:
        made = encoded(samples, threshold)
        payload = None if made is None else packed(*made).hex()
        after = None if made is None else played(*made, threshold)
        frames.append({"name": name, "threshold": threshold, "samples": samples, "payload": payload, "played": after})
    return {"note": NOTE, "frames": frames, "refused": [{"name": name, "payload": hexed} for name, hexed in REFUSED]}


if __name__ == "__main__":
    FILE.write_text(json.dumps(document(), indent=1) + "\n", encoding="utf-8")
