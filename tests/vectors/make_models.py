"""Write tests/vectors/models.json: models of the contact ahead as payloads, and the forces that they make.

Run ``python -m tests.vectors.make_models`` after an intended change. It follows docs/refer/payloads.md with struct
and math alone and imports nothing of hapticnet.
"""

import json
import math
import struct
from pathlib import Path

FILE = Path(__file__).with_name("models.json")

NOTE = (
    "Payloads with models of the contact ahead. 'path' is a list of [time in us, position in m]; the model belongs to"
    " the entry number 'begins', and 'forces' are those at that entry and each one after it."
)

GROUPS = [
    (0, ["surface", "stiffness"]),
    (2, ["breach force"]),
    (4, ["viscosity"]),
    (8, ["stiffening"]),
    (16, ["friction", "presliding", "friction now"]),
    (32, ["recovery", "raised"]),
]
PLAIN = {"surface": 0.02, "stiffness": 200.0, "breach force": 2.0}
RICH = {
    "surface": 0.0205,
    "stiffness": 150.0,
    "breach force": 1.0,
    "viscosity": 2.0,
    "stiffening": 100.0,
    "friction": 0.2,
    "presliding": 0.0005,
    "friction now": 0.0,
    "recovery": 0.3,
    "raised": 0.0,
}
PIERCED = RICH | {"pierced": True, "raised": 0.004, "friction now": 0.15}
WALL = {"surface": 0.01, "stiffness": 3000.0, "normal": [0.0, 0.6, 0.8]}
TILTED = {"surface": 0.012, "stiffness": 500.0, "viscosity": 1.5, "normal": [1.0, 0.0]}

IN_AND_OUT = [[1000 * k, [0.018 + 0.012 * math.sin(k / 16.0)]] for k in range(64)]

MODELS = [
    ("nothing ahead", [], IN_AND_OUT[:3], 0),
    ("a spring that breaks", [PLAIN], IN_AND_OUT, 3),
    ("every property", [RICH], IN_AND_OUT, 1),
    ("a pierced layer and one behind it", [PIERCED, PLAIN | {"surface": 0.028}], IN_AND_OUT, 20),
    ("a wall on three axes", [WALL], [[1000 * k, [0.0, 0.001 * k, 0.0005 * k]] for k in range(20)], 2),
    ("a viscous wall on two axes", [TILTED], [[1000 * k, [0.001 * k, 0.0]] for k in range(20)], 5),
]


def pack(layers):
    data = bytes([1, len(layers)])
    for layer in layers:
        groups = [(flag, names) for flag, names in GROUPS if names[0] in layer]
        data += bytes([sum(flag for flag, _ in groups) + bool(layer.get("pierced"))])
        values = [layer[name] for _, names in groups for name in names] + layer.get("normal", [])
        data += struct.pack(f">{len(values)}f", *values)
    return data


def single(value):
    return struct.unpack(">f", struct.pack(">f", value))[0]


def forces(layers, path, begins):
    layers = [{key: rounded(value) for key, value in layer.items()} for layer in layers]
    made, before = [], path[begins - 1] if begins else path[0]
    for layer in layers:
        layer["depth"] = depth(layer, path[begins][1])
    for index in range(begins, len(path)):
        t_us, x = path[index]
        elapsed_s = (t_us - before[0]) / 1e6
        total = [0.0] * len(x)
        for layer in layers:
            if index > begins and layer.get("raised"):
                layer["raised"] *= math.exp(-elapsed_s / layer["recovery"])
            n = layer.get("normal", [1.0])
            speed = sum(c * (a - b) for c, a, b in zip(n, x, before[1], strict=True))
            speed = speed / elapsed_s if elapsed_s else 0.0
            force = press(layer, depth(layer, x), max(-10.0, min(10.0, speed)))
            total = [sum_ + force * c for sum_, c in zip(total, n, strict=True)]
        made.append(total)
        before = path[index]
    return made


def rounded(value):
    if isinstance(value, bool):
        return value
    return [single(each) for each in value] if isinstance(value, list) else single(value)


def depth(layer, x):
    return sum(a * b for a, b in zip(x, layer.get("normal", [1.0]), strict=True)) - layer["surface"]


def press(layer, d, speed):
    raised = layer.get("raised", 0.0)
    if layer.get("pierced"):
        if d >= raised:
            return slide(layer, d)
        layer["pierced"], layer["friction now"] = False, 0.0
    i = d - raised
    if i <= 0.0:
        return 0.0
    k, a, limit = layer["stiffness"], layer.get("stiffening", 0.0), layer.get("breach force", math.inf)
    elastic = k / a * math.expm1(a * i) if a else k * i
    if elastic > limit:
        breaks_at = math.log1p(a * limit / k) / a if a else limit / k
        layer["pierced"], layer["friction now"] = True, 0.0
        layer["depth"] = min(d, raised + breaks_at)
        if "recovery" in layer:
            layer["raised"] = layer["depth"]
        return slide(layer, d)
    if "viscosity" in layer:
        elastic = max(0.0, elastic + layer["viscosity"] * speed)
    return min(elastic, 1000.0)


def slide(layer, d):
    if "friction" not in layer:
        return 0.0
    travel, layer["depth"] = d - layer["depth"], d
    if travel:
        end = math.copysign(layer["friction"], travel)
        layer["friction now"] = end + (layer["friction now"] - end) * math.exp(-abs(travel) / layer["presliding"])
    return layer["friction now"]


def document():
    vectors = [
        {
            "name": name,
            "axes": len(path[0][1]),
            "payload": pack(layers).hex(),
            "path": path,
            "begins": begins,
            "forces": forces(layers, path, begins),
        }
        for name, layers, path, begins in MODELS
    ]
    return {"note": NOTE, "models": vectors}


if __name__ == "__main__":
    FILE.write_text(json.dumps(document(), indent=1) + "\n", encoding="utf-8")
