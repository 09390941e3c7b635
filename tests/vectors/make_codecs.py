"""Write tests/vectors/codecs.json: payloads of every codec, and what a receiver applies.

Run ``python -m tests.vectors.make_codecs`` after an intended change of a codec; the tests say whether it is needed.
"""

import itertools
import json
import sys
from pathlib import Path

import numpy as np

from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw

FILE = Path(__file__).with_name("codecs.json")

NOTE = (
    "Samples are [t_us, force_n, position_m, payload, arrives, applied_n]. The encoder gets time, force and position;"
    " payload is what it sends (hex) or null. Where it arrives, the receiver decodes it; one that it must refuse is"
    " 'refused'. Then it applies applied_n at t_us, with its tool at position_m. 'later' are [t_us, position_m,"
    " applied_n] without further payloads. Each of 'refused' must be refused at the end and change nothing. Numbers are"
    " shortest decimals of float64."
)

LATER_US = (1, 999, 10_000, 19_999, 50_000, 99_999, 100_000, 150_000, 200_001, 2**31 - 1, 2**31 + 7, 2**32 + 11, 2**40)

STEP = {"step_n": 0.001}
FINE = {"weber_fraction": 1e-12, "floor_n": 0.0}
COARSE = {"weber_fraction": 0.1, "floor_n": 0.05, "multiplier": 2.0}

CASES = [
    *[(name, parameters, {}, axes) for name in ("raw", "deadband") for parameters in ({}, STEP) for axes in (1, 2, 3)],
    *[("deadband", parameters, FINE, axes) for parameters in ({}, STEP) for axes in (1, 3)],
    *[
        (name, parameters, law, axes)
        for name in ("velocity-adaptive", "probabilistic", "merging")
        for parameters, law, axes in (({}, {}, 1), (STEP, COARSE, 2), ({}, FINE, 1))
    ],
    *[("level-crossing", {"hysteresis": 0.25}, law, axes) for law in ({}, COARSE) for axes in (1, 2, 3)],
    ("level-crossing", {"hysteresis": 0.0}, {}, 1),
    ("level-crossing", {"hysteresis": 0.5}, {"multiplier": 40.0}, 1),
    ("level-crossing", {"hysteresis": 0.25}, {"weber_fraction": 1e-12, "floor_n": 1e-5}, 1),
    ("level-crossing", {"hysteresis": 0.25}, FINE, 1),
    *[
        (name, parameters, law, axes)
        for name in ("adaptive-predictive", "linear-predictive")
        for parameters, law in (({}, {}), (STEP, COARSE))
        for axes in (1, 2, 3)
    ],
    ("adaptive-predictive", {"horizon_ms": 7.0, "jump_thresholds": 1.0}, FINE, 1),
    ("linear-predictive", {"horizon_ms": 7.0, "slope_samples": 2}, FINE, 1),
    *[("least-squares", parameters, law, axes) for parameters, law in (({}, {}), (STEP, COARSE)) for axes in (1, 2, 3)],
    *[("least-squares", {"updates": 5.0, "absolute_every": 127.0, "horizon_ms": 9.0}, COARSE, axes) for axes in (1, 3)],
    ("least-squares", {}, FINE, 1),
    *[
        (name, parameters, law, axes)
        for name in ("passive-extrapolative", "passive-interpolative")
        for parameters, law in (({}, {}), (STEP, COARSE))
        for axes in (1, 2, 3)
    ],
    ("passive-interpolative", {"interval_ms": 0.0}, FINE, 1),
    ("passive-extrapolative", {}, FINE, 1),
    *[("motion-predictive", {}, law, axes) for law in ({}, COARSE) for axes in (1, 2, 3)],
    *[("motion-predictive", {"horizon_ms": 9.0, "stiffest_n_per_m": 200.0}, FINE, axes) for axes in (1, 3)],
]


def signal(axes, seed, samples=36):
    """Return times, forces and positions: rest, a ramp, a breach, noise, a repeated time, a sign change, zero."""
    rng = np.random.default_rng(seed)
    t_us = 5_000_000 + np.cumsum(rng.choice([1000, 1000, 1000, 3500], samples))
    t_us[20] = t_us[19]
    force = np.zeros((samples, axes))
    for axis in range(axes):
        scale = (1.0, -0.6, 0.3)[axis]
        force[2:16, axis] = scale * np.linspace(0.1, 3.0, 14) ** 1.5
        force[16:28, axis] = scale * (1.2 + rng.normal(0.0, 0.12, 12))
        force[28:34, axis] = -scale * np.linspace(0.4, 0.01, 6)
    position = np.cumsum(rng.normal(2e-4, 4e-4, (samples, axes)), axis=0)
    position[9] = position[8]
    return t_us.tolist(), force.round(4).tolist(), position.round(6).tolist()


def ties(axes, samples=36):
    """Return times, forces and positions whose residuals are mostly 5, 6 or 7 steps of half a threshold of 0.1 N."""
    t_us = list(range(7_000_000, 7_000_000 + 2000 * samples, 2000))
    moves = (0.3, 0.3, -0.3, 0.25, 0.35, -0.3, -0.3, 0.2, 0.15, 0.1)
    force = np.cumsum([[moves[(n + axis) % len(moves)] for axis in range(axes)] for n in range(samples)], axis=0)
    return t_us, force.round(4).tolist(), np.zeros((samples, axes)).tolist()


def contact(axes, seed, samples=240):
    """Return times, forces and positions of a hand on a surface, then on a spring with viscosity, then off both."""
    rng = np.random.default_rng(seed)
    t_us = (9_000_000 + 1000 * np.arange(samples)).tolist()
    depth = 4e-3 * np.sin(np.arange(samples) / 25.0) + rng.normal(0.0, 2e-6, samples)
    position = depth[:, None] * np.array([1.0, -0.5, 0.2])[:axes] + rng.normal(0.0, 1e-5, (samples, axes))
    position = position.round(7)
    velocity = np.diff(position, axis=0, prepend=position[:1]) / 1e-3
    force = 900.0 * np.clip(position, 0.0, None)
    force[100:] = 300.0 * position[100:] + 1.5 * velocity[100:] + 0.4
    force[220:] = 0.0
    return t_us, force.round(4).tolist(), position.tolist()


def far(axes, samples=300):
    """Return times, forces and positions whose values need float64: a steep slope, then a spring far away."""
    ticks = np.arange(samples)
    t_us = (3_000_000 + 1000 * ticks).tolist()
    sway = np.where(ticks < 60, 0.0, 4e-3 * np.sin((ticks - 60) / 25.0))
    position = 1e5 + (sway[:, None] * np.array([1.0, -0.5, 0.2])[:axes]).round(9)
    velocity, force = np.zeros(axes), np.zeros((samples, axes))
    for tick in range(samples):
        before = position[max(tick - 1, 0)]
        velocity = ((position[tick] - before) + 0.005 * velocity) / 0.006
        force[tick] = 1e6 + 0.05 * tick if tick < 60 else 300.0 * (position[tick] - 1e5) + 1.5 * velocity
    return t_us, force.tolist(), position.tolist()


def case(number, name, parameters, law, axes, lost=(), samples_of=None):
    """Return one case; updates whose index is in `lost` do not arrive."""
    codec = make_codec(name, WeberLaw(**law), parameters)
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    samples, forms, updates = [], set(), 0
    for t_us, force, position in zip(*(samples_of or signal(axes, number)), strict=True):
        payload = encoder.encode(t_us, tuple(force), tuple(position))
        arrives = None
        if payload is not None:
            arrives = updates not in lost
            updates += 1
            forms.add(form_of(name, payload, axes))
            if arrives:
                try:
                    decoder.decode(t_us, payload)
                except PeerError:
                    arrives = "refused"
        applied = decoder.reconstruct(t_us, tuple(position))
        samples.append([t_us, force, position, payload.hex() if payload else None, arrives, list(applied)])
    refused = []
    for payload in bad_payloads(name, axes, [bytes.fromhex(sample[3]) for sample in samples if sample[3]][-1]):
        try:
            decoder_after(codec, axes, samples).decode(samples[-1][0], payload)
        except PeerError:
            refused.append(payload.hex())
    later = [
        [samples[-1][0] + us, samples[-1][2], list(decoder.reconstruct(samples[-1][0] + us, tuple(samples[-1][2])))]
        for us in LATER_US
    ]
    lawful = WeberLaw(**law)
    return {
        "name": f"{name}, {', '.join(sorted(forms))}, axes {axes}{', updates lost' if lost else ''} (case {number})",
        "codec": name,
        "parameters": parameters,
        "weber_fraction": lawful.weber_fraction,
        "floor_n": lawful.floor_n,
        "multiplier": lawful.multiplier,
        "axes": axes,
        "forms": sorted(forms),
        "samples": samples,
        "later": later,
        "refused": refused,
    }


def decoder_after(codec, axes, samples):
    """Return a decoder in the state after all samples."""
    decoder = codec.decoder(axes)
    for t_us, _, position, payload, arrives, _ in samples:
        if arrives is True:
            decoder.decode(t_us, bytes.fromhex(payload))
        decoder.reconstruct(t_us, tuple(position))
    return decoder


def bad_payloads(name, axes, good):
    """Return payloads that every receiver should refuse, and some that only some refuse."""
    single = bytes.fromhex("3f800000" * axes)
    yield from (b"", good + b"\0", good[:-1], bytes.fromhex("7fc00000" * axes))
    yield bytes.fromhex("7f800000" * axes) + (b"\0\0" * axes if name == "adaptive-predictive" else b"")
    for values in ("7ff0000000000000",), ("8000",), ("8000", "0000"), ("0fff",):
        yield bytes.fromhex("".join(value * axes for value in values))
    for value in ("7c00", "6401", "7fc00000"):
        yield single + bytes.fromhex(value * axes)
    yield bytes([good[0] ^ 0x40]) + good[1:]
    yield bytes([good[0] & 0x7F]) + b"\xff" * (4 * axes + 1)
    if name == "motion-predictive":
        yield b"\x04" + single
        yield b"\x02" + single + bytes.fromhex("0000" * axes)
        yield b"\x02" + single + bytes.fromhex("7bff" * axes)
        yield b"\x01" + single + bytes.fromhex("6401" * axes)
        yield b"\x03" + single * 2 + bytes.fromhex("bc003c00")
        yield b"\x03" + single * 2 + bytes.fromhex("3c0063d1")
        yield b"\x03" + single + bytes.fromhex("7fc00000" * axes + "3c003c00")
    if name == "model-mediated":
        yield b"\x00" + bytes.fromhex("7fc00000" * axes)
        yield b"\x00" + bytes.fromhex("7ff0000000000000" * axes)
        yield b"\x01" + bytes.fromhex("7fc00000") + single
        yield b"\x01" + bytes.fromhex("58635fa9") + single
        yield b"\x01" + bytes.fromhex("3f800000" + "49742410" * axes)
        yield b"\x02" + bytes.fromhex("3f800000") + single


def form_of(name, payload, axes):
    """Return the document's word for a form."""
    size = len(payload) / axes
    if name == "least-squares":
        if not payload[0] & 0x80:
            return "residual"
        size = (len(payload) - 1) / axes
    if name in ("linear-predictive", "least-squares"):
        return {4: "line of counts", 8: "line of singles", 12: "line of doubles"}[size]
    if name == "model-mediated":
        return "wall" if payload[0] else "single"
    if name == "motion-predictive":
        kind = ("hold", "curve", "surface", "coupled")[payload[0] & 7]
        return f"{kind} of doubles" if payload[0] & 8 else f"{kind} of singles"
    if name == "adaptive-predictive":
        return {4: "curve of counts", 6: "curve of singles", 10: "curve of doubles"}[size]
    return {2: "levels" if name == "level-crossing" else "counts", 4: "single", 8: "double"}[size]


def document():
    """Return the whole content of the file."""
    every_codec()  # loads those of the literature
    cases = [case(number, *each) for number, each in enumerate(CASES)]
    cases += [case(100 + axes, "least-squares", {"absolute_every": 8.0}, COARSE, axes, lost=(3, 9)) for axes in (1, 2)]
    flat, narrow = ({"weber_fraction": 0.0, "floor_n": floor_n} for floor_n in (0.1, 0.01))
    for number, (axes, fraction) in enumerate(((1, 0.5), (2, 0.5), (1, 0.8), (3, 0.8)), 110):
        rare = {"updates": 3.0, "step_fraction": fraction}
        cases.append(case(number, "least-squares", rare, flat, axes, samples_of=ties(axes)))
    for number, (law, axes) in enumerate(itertools.product(({}, FINE), (1, 2, 3))):
        cases.append(case(120 + number, "motion-predictive", {}, law, axes, samples_of=contact(axes, number)))
    cases += [case(130 + axes, "motion-predictive", {}, narrow, axes, samples_of=far(axes)) for axes in (1, 2, 3)]
    for number, (law, axes) in enumerate(itertools.product(({}, COARSE), (1, 2, 3)), 140):
        quick = {"gain": 20.0, "blend_ms": 0.0 if law else 50.0}
        touched = contact(axes, number)
        cases.append(case(number, "model-mediated", quick, law, axes, samples_of=touched))
    return {"protocol_version": 1, "note": NOTE, "cases": cases}


def text():
    """Return the file's text: one sample per line."""
    content = document()
    lines = [f' "protocol_version": {content["protocol_version"]},', f' "note": {json.dumps(content["note"])},']
    cases = []
    for each in content["cases"]:
        rows = []
        for key, value in each.items():
            if key in ("samples", "later"):
                inner = ",\n".join(f"    {json.dumps(row)}" for row in value)
                rows.append(f'   "{key}": [\n{inner}\n   ]')
            else:
                rows.append(f"   {json.dumps(key)}: {json.dumps(value)}")
        cases.append("  {\n" + ",\n".join(rows) + "\n  }")
    return "{\n" + "\n".join(lines) + '\n "cases": [\n' + ",\n".join(cases) + "\n ]\n}\n"


if __name__ == "__main__":
    FILE.write_text(text())
    sys.stdout.write(f"wrote {FILE}\n")
