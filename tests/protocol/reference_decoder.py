"""A decoder of every codec, written from docs/refer/payloads.md alone; it imports nothing of hapticnet.

It is what a peer in another language would write: `Receiver(...)`, `decode(t, payload)`, `applied(t, position)`.
"""

import math
import struct

LARGEST = 1e15

# Defaults of the parameters, as the document has them.
DEFAULTS = {
    "raw": {"step_n": 0},
    "deadband": {"step_n": 0},
    "adaptive-predictive": {"horizon_ms": 200, "window_ms": 17, "jump_thresholds": 0, "step_n": 0},
    "motion-predictive": {"horizon_ms": 200, "window_ms": 17, "stiffest_n_per_m": 10000},
    "linear-predictive": {"slope_samples": 5, "horizon_ms": 100, "step_n": 0},
    "least-squares": {"updates": 2, "horizon_ms": 100, "step_fraction": 0.5, "absolute_every": 16, "step_n": 0},
    "level-crossing": {"hysteresis": 0.25},
    "velocity-adaptive": {"speed_gain_s_m": 0.5, "largest_fraction": 0.25, "time_constant_ms": 10, "step_n": 0},
    "passive-extrapolative": {"step_n": 0},
    "passive-interpolative": {"interval_ms": 20, "step_n": 0},
    "probabilistic": {"loss_probability": 0.1, "deviation_limit": 0.05, "step_n": 0},
    "merging": {"window_ms": 10, "step_n": 0},
    "model-mediated": {"gain": 0.1, "first_n_per_m": 200, "deadband": 0.1, "blend_ms": 50},
}


class Refused(Exception):  # noqa: N818
    """A payload that the document says is refused."""


def limit(x):
    return max(-LARGEST, min(x, LARGEST))


def norm(x):
    if len(x) == 1:
        return abs(x[0])
    total = 0.0
    for component in x:
        total += component * component
    return math.sqrt(total)


def inner(x, y):
    total = x[0] * y[0]
    for a, b in zip(x[1:], y[1:], strict=True):
        total += a * b
    return total


def read(data, letter, axes):
    return [float(x) if letter != "h" else x for x in struct.unpack(f">{axes}{letter}", data)]


def in_range(x):
    if not all(-LARGEST <= component <= LARGEST for component in x):
        raise Refused(x)
    return list(x)


def slope_through(known):
    newest_t, newest = known[-1]
    n, total, squares = len(known), 0.0, 0.0
    for t, _ in known:
        total += float(t - newest_t)
        squares += float(t - newest_t) * float(t - newest_t)
    spread = n * squares - total * total
    slopes = []
    for axis in range(len(newest)):
        product = 0.0
        for t, x in known:
            product += (n * float(t - newest_t) - total) * (x[axis] - newest[axis])
        slopes.append(limit(1e6 * product / spread) if spread else 0.0)
    return slopes


def median_filtered(known):
    filtered = list(known)
    for index in range(1, len(known) - 1):
        three = zip(*(x for _, x in known[index - 1 : index + 2]), strict=True)
        filtered[index] = known[index][0], [sorted(axis)[1] for axis in three]
    return filtered


def levels(share, weber_fraction, floor_n):
    kappa = max(min(share * weber_fraction, 0.5) - 2.0**-46, 0.0)
    phi = (share * floor_n) * (1.0 - 2.0**-36)
    found, end = [0.0], phi
    while len(found) <= 4096 and end < LARGEST:
        following = max(end + phi, end / (1.0 - kappa))
        if following > LARGEST or following <= found[-1]:
            break
        found.append(following)
        end = following + max(kappa * following, phi)
    return found


class Receiver:
    """One direction of one session."""

    def __init__(self, codec, parameters, *, weber_fraction, floor_n, multiplier, axes):
        self.codec, self.axes = codec, axes
        self.set = {**DEFAULTS[codec], **parameters}
        self.law = multiplier * weber_fraction, multiplier * floor_n
        self.value = [0.0] * axes
        self.t0 = None
        self.slope = [0.0] * axes
        self.travel = [0.0] * axes
        self.number = None
        self.before = self.direction = None
        self.at = None
        self.velocity = [0.0] * axes
        self.ramp_from, self.ramp_us, self.delta = self.value, 0, 0.0
        self.wall, self.surface, self.missing, self.t_moved = None, 0.0, 0.0, 0
        if codec == "level-crossing":
            share = ((1.0 - self.set["hysteresis"]) / math.sqrt(axes)) * multiplier
            self.levels = levels(share, weber_fraction, floor_n)

    def threshold(self, size):
        return max(self.law[0] * size, self.law[1])

    def decode(self, t, payload):
        axes = self.axes
        if self.codec == "adaptive-predictive":
            value = self.read_value(payload[: -2 * axes])
            multiples = read(payload[-2 * axes :], "e", axes)
            travel = [m * self.threshold(norm(value)) for m in multiples]
            if not all(abs(m) <= 1024 for m in multiples):
                raise Refused(multiples)
            in_range([v + way for v, way in zip(value, travel, strict=True)])
            self.value, self.travel = value, travel
        elif self.codec == "motion-predictive":
            self.decode_motion(payload)
        elif self.codec == "linear-predictive":
            self.value, self.slope = self.read_line(payload)
        elif self.codec == "least-squares":
            self.decode_least_squares(t, payload)
        elif self.codec == "level-crossing" and len(payload) == 2 * axes:
            indices = read(payload, "h", axes)
            if max(map(abs, indices)) >= len(self.levels):
                raise Refused(indices)
            self.value = [math.copysign(self.levels[abs(i)], i) if i else 0.0 for i in indices]
        elif self.codec.startswith("passive"):
            self.decode_passive(t, payload)
        elif self.codec == "model-mediated":
            self.decode_wall(payload)
        else:
            self.value = self.read_value(payload)
        self.t0 = t

    def applied(self, t, position=None):
        if self.codec.startswith("passive"):
            return self.applied_passive(t, position)
        if self.codec == "model-mediated":
            return self.applied_wall(t, position)
        if self.codec == "motion-predictive":
            return self.applied_in_motion(t, position)
        if self.t0 is None:
            return self.value
        if self.codec == "adaptive-predictive":
            share = self.share(t)
            return [v + way * share for v, way in zip(self.value, self.travel, strict=True)]
        if self.codec in ("linear-predictive", "least-squares"):
            return self.on_line(t)
        return self.value

    def share(self, t):
        s = (t - self.t0) / (self.set["horizon_ms"] * 1000.0)
        return 0.0 if s <= 0 else 1.0 if s >= 1 else s * (2.0 - s)

    def decode_motion(self, payload):
        axes = self.axes
        first = payload[0] if payload else 255
        letter, kind = ("d", first - 8) if first & 8 else ("f", first)
        size = axes * (8 if letter == "d" else 4)
        lengths = {0: 0, 1: 2 * axes, 2: 2 * axes + (2 if axes > 1 else 0), 3: 4 * axes + 4}
        if kind not in lengths or len(payload) != 1 + size + lengths[kind]:
            raise Refused(payload)
        value, rest = in_range(read(payload[1 : 1 + size], letter, axes)), payload[1 + size :]
        travel, normal, stiffness, viscosity = [0.0] * axes, None, 0.0, 0.0
        if kind == 1:
            multiples = read(rest, "e", axes)
            travel = [m * self.threshold(norm(value)) for m in multiples]
            if not all(abs(m) <= 1024 for m in multiples):
                raise Refused(multiples)
            in_range([v + way for v, way in zip(value, travel, strict=True)])
        elif kind == 2:
            normal = read(rest[: 2 * axes], "e", axes)
            stiffness = read(rest[2 * axes :], "e", 1)[0] if axes > 1 else 0.0
            largest = 1.002 * self.set["stiffest_n_per_m"]
            if not (any(normal) and inner(normal, normal) <= largest and 0.0 <= stiffness <= largest):
                raise Refused(normal)
        elif kind == 3:
            travel = in_range(read(rest[: 4 * axes], "f", axes))
            stiffness, viscosity = read(rest[4 * axes :], "e", 2)
            if not (0.0 <= stiffness <= 1.002 * self.set["stiffest_n_per_m"] and 0.0 <= viscosity <= 1000.0):
                raise Refused((stiffness, viscosity))
        self.value, self.travel = value, travel
        self.line = kind, normal, stiffness, viscosity

    def applied_in_motion(self, t, position):
        if position is not None and (self.at is None or self.at[0] != t):
            if self.at is None or t < self.at[0]:
                self.velocity = [0.0] * self.axes
            else:
                before_t, before = self.at
                self.velocity = [
                    ((p - q) + 0.005 * v) / (0.005 + (t - before_t) * 1e-6)
                    for p, q, v in zip(position, before, self.velocity, strict=True)
                ]
            self.at = t, list(position)
        if self.t0 is None:
            return self.value
        kind, normal, stiffness, viscosity = self.line
        share = self.share(t)
        if kind < 2:
            return [v + share * way for v, way in zip(self.value, self.travel, strict=True)]
        if self.at is None:
            return [0.0] * self.axes
        at = self.at[1]
        if kind == 2:
            depth = inner(normal, at)
            added = [depth * k for k in normal]
            if stiffness:
                back = -depth / inner(normal, normal)
                across = [p + back * k for p, k in zip(at, normal, strict=True)]
                added = [a + stiffness * p for a, p in zip(added, across, strict=True)]
            x = [c + a for c, a in zip(self.value, added, strict=True)]
            out = inner(normal, x)
            if out < 0.0:
                back = -out / inner(normal, normal)
                x = [c + back * k for c, k in zip(x, normal, strict=True)]
            return [limit(c) for c in x]
        x = [c + share * way for c, way in zip(self.value, self.travel, strict=True)]
        x = [c + stiffness * p for c, p in zip(x, at, strict=True)]
        return [limit(c + viscosity * v) for c, v in zip(x, self.velocity, strict=True)]

    def read_value(self, data):
        axes, step = self.axes, self.set.get("step_n", 0)
        if len(data) == 2 * axes and step:
            counts = read(data, "h", axes)
            if min(counts) == -32768:
                raise Refused(counts)
            return [count * step for count in counts]
        if len(data) == 4 * axes:
            return in_range(read(data, "f", axes))
        if len(data) == 8 * axes and self.codec != "raw":
            return in_range(read(data, "d", axes))
        raise Refused(len(data))

    def read_line(self, data):
        axes = self.axes
        if len(data) == 4 * axes:
            unit = (self.set["step_n"] * 1000.0) / self.set["horizon_ms"]
            return self.read_value(data[: 2 * axes]), [c * unit for c in read(data[2 * axes :], "h", axes)]
        if len(data) not in (8 * axes, 12 * axes):
            raise Refused(len(data))
        return self.read_value(data[: -4 * axes]), in_range(read(data[-4 * axes :], "f", axes))

    def on_line(self, t):
        if self.t0 is None or t <= self.t0:
            return self.value
        elapsed = min(float(t - self.t0), self.set["horizon_ms"] * 1000.0)
        return [limit(v + (slope * 1e-6) * elapsed) for v, slope in zip(self.value, self.slope, strict=True)]

    def decode_least_squares(self, t, payload):
        if not payload:
            raise Refused("empty")
        number, fraction = payload[0] & 127, self.set["step_fraction"]
        if payload[0] & 128:
            self.value, self.slope = self.read_line(payload[1:])
            self.known = [(t, self.value)]
            self.sum, self.n = math.floor(2.0 / fraction + 0.5), 1
            self.number = number
            return
        if number != self.number or len(payload) > 1 + 4 * self.axes:
            raise Refused(number)
        k = 0
        while self.n * 2**k < self.sum and k < 30:
            k += 1
        folded = self.read_golomb_rice(payload[1:], k)
        r = [u // 2 if u % 2 == 0 else -(u + 1) // 2 for u in folded]
        p = self.on_line(t)
        step = fraction * self.threshold(norm(p))
        value = in_range([at + steps * step for at, steps in zip(p, r, strict=True)])
        impact = norm([float(steps) for steps in r]) * fraction > 3.0
        self.known = [(t, value)] if impact else [*self.known, (t, value)][-int(self.set["updates"]) :]
        self.value, self.slope = value, slope_through(median_filtered(self.known))
        self.sum += sum(folded)
        self.n += self.axes
        if self.n >= 32:
            self.sum, self.n = self.sum // 2, self.n // 2
        self.number = (number + 1) % 128

    def read_golomb_rice(self, data, k):
        bits = "".join(f"{byte:08b}" for byte in data)
        at, folded = 0, []
        for _ in range(self.axes):
            zero = bits.find("0", at)
            end = zero + 1 + k
            if zero < 0 or end > len(bits):
                raise Refused("ends early")
            folded.append((zero - at << k) + int(bits[zero + 1 : end] or "0", 2))
            at = end
        if len(bits) - at >= 8 or "1" in bits[at:]:
            raise Refused("filled with something")
        return folded

    def ramp(self, t):
        """Return where the ramp is, or None where it is over."""
        if self.t0 is None or not 0 <= t - self.t0 < self.ramp_us:
            return None
        share = (t - self.t0) / self.ramp_us
        return [f + share * (v - f) for f, v in zip(self.ramp_from, self.value, strict=True)]

    def decode_passive(self, t, payload):
        value, interval_us = self.read_value(payload), self.set.get("interval_ms", 0) * 1000.0
        gap = 0 if self.t0 is None else t - self.t0
        ramps = gap > 0 and interval_us > 0
        self.ramp_from = (self.ramp(t) or self.value) if ramps else value
        self.ramp_us = min(gap, interval_us) if ramps else 0
        self.value = value
        h = self.threshold(norm(value))
        self.delta = h + 2.0**-50 * ((h + 2.0 * norm(value)) + norm(self.ramp_from))

    def applied_passive(self, t, position):
        if position is not None and position != self.before:
            if self.before is not None:
                m = [new - old for new, old in zip(position, self.before, strict=True)]
                if self.axes == 1:
                    self.direction = [math.copysign(1.0, m[0])]
                else:
                    square = sum((x * x for x in m), 0.0)
                    if square < 1e-280:
                        m = [x / max(map(abs, m)) for x in m]
                        square = sum((x * x for x in m), 0.0)
                    self.direction = [x / math.sqrt(square) for x in m]
            self.before = position
        if self.t0 is None or self.direction is None:
            return self.value
        d, base, delta = self.direction, self.ramp(t), self.delta
        if base is None:
            return [v + delta * u for v, u in zip(self.value, d, strict=True)]
        ahead = 0.0
        for v, b, u in zip(self.value, base, d, strict=True):
            ahead += (v - b) * u
        delta = delta + ahead if ahead > 0.0 else delta
        return [b + delta * u for b, u in zip(base, d, strict=True)]

    def whole(self):
        """Return the force of the wall with nothing left to be blended in, and its stiffness."""
        k = norm(self.wall)
        if k == 0.0 or self.before is None:
            return 0.0, k
        return max(k * (inner(self.wall, self.before) / k - self.surface), 0.0), k

    def wall_now(self):
        """Return what the wall, or a held value, applies at the newest position."""
        if self.wall is None:
            return self.value
        whole, k = self.whole()
        size = whole - self.missing
        return [limit(w * (size / k)) for w in self.wall] if size > 0.0 else [w * 0.0 for w in self.wall]

    def decode_wall(self, payload):
        if payload[:1] == b"\0" and len(payload) == 1 + 4 * self.axes:
            self.value, self.wall, self.missing = in_range(read(payload[1:], "f", self.axes)), None, 0.0
            return
        if len(payload) != 5 + 4 * self.axes or payload[0] != 1:
            raise Refused(payload)
        surface, *wall = read(payload[1:], "f", self.axes + 1)
        if not all(abs(w) <= 1e6 for w in wall) or not abs(surface) <= 2e15:
            raise Refused(wall)
        before = norm(self.wall_now())
        self.surface, self.wall = surface, wall
        self.missing = max(self.whole()[0] - before, 0.0)

    def applied_wall(self, t, position):
        if position is not None:
            passed = (t - self.t_moved) * 1e-6 if self.before is not None and t > self.t_moved else 0.0
            tau = self.set["blend_ms"] * 1e-3
            self.missing = self.missing * (tau / (tau + passed)) if tau > 0.0 else 0.0
            self.before, self.t_moved = position, t
        return self.wall_now()
