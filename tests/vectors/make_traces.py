"""Write tests/vectors/traces.json: what arrives at a master or slave, and what it makes of that.

Run ``python -m tests.vectors.make_traces`` after an intended change of the protocol. It follows docs/refer/protocol.md
and the decoder in `tests.protocol.reference_decoder`, and imports nothing of hapticnet.
"""

import json
import math
import struct
from pathlib import Path

import msgpack

from tests.protocol.reference_decoder import Receiver, Refused
from tests.vectors.make_protocol import FORCE, KEEPALIVE, SESSION
from tests.vectors.make_refused import single

FILE = Path(__file__).with_name("traces.json")

NOTE = (
    "Open sessions of one axis, as their master sees them; WELCOME has sequence 0 and arrives at 0 us. At each entry it"
    " samples 'position_m' at 'now_us', sends a POSITION with this 'newest' (a report of loss may follow), takes in"
    " what 'arrives', and asks its decoder, which gives 'stimulus_n'. 'slave': a session as a slave sees it. At each"
    " entry a POSITION 'arrives', and 'answer' is sent. The scene is a spring of 300 N/m behind 0.02 m, the codec"
    " deadband with the same law. 'why' is for people."
)

PERIOD_US = 1000
LAW = {"weber_fraction": 0.05, "floor_n": 0.025, "multiplier": 1.0}


def force(sequence, t_us, payload, why):
    return FORCE, sequence, t_us, payload, why


def keepalive(sequence, t_us, newest, why):
    return KEEPALIVE, sequence, t_us, newest, why


def coupled(value, stiffness, viscosity):
    """Return a payload of motion-predictive that holds value + stiffness · p + viscosity · v."""
    return b"\x03" + struct.pack(">ffee", value, 0.0, stiffness, viscosity)


WITH_LOSS = {
    3000: [force(1, 1000, single(1.0), "the first")],
    5000: [force(2, 3000, single(1.2), "in order")],
    8000: [keepalive(4, 6000, 3, "FORCE 3 is lost or late: this confirms nothing")],
    10000: [force(5, 8000, single(1.5), "the repair of FORCE 3")],
    11000: [force(3, 5000, single(1.4), "older than the newest applied: dropped")],
    12000: [force(5, 8000, single(1.5), "a copy")],
    14000: [keepalive(6, 12000, 5, "confirms FORCE 5, and is acknowledged in its place")],
    15000: [keepalive(8, 13000, 7, "overtook FORCE 7")],
    16000: [force(7, 12500, single(1.7), "late, but newer than the newest applied")],
    18000: [force(9, 16000, b"\x00\x00\x00", "its payload is refused: not acknowledged")],
    19000: [keepalive(10, 17000, 7, "FORCE 7 still holds: 9 was never applied")],
    21000: [force(11, 60000, single(9.0), "answers a position that was not sent")],
    22000: [force(12, 20000, struct.pack(">d", 0.1), "as float64")],
    24000: [force(14, 22000, single(0.3), "after a gap"), keepalive(15, 23000, 14, "in the same tick")],
    25000: [keepalive(13, 21000, 12, "late: counts for nothing")],
}

FIRST_POSITIONS = {
    20000: [force(9, 15000, coupled(1.0, 0.0, 50.0), "earlier ones were lost; all positions so far make the velocity")],
    40000: [force(20, 36000, coupled(1.0, 100.0, 40.0), "in motion")],
}


def ramp(t_us):
    return 0.02 * t_us / 1e6


def stops(t_us):
    return ramp(min(t_us, 15_000))


def swing(t_us):
    return 0.02 + 0.003 * math.sin(t_us / 20_000.0)


def trace(name, codec, place, script, end_us):
    receiver = Receiver(codec, {}, axes=1, **LAW)
    applied, confirmed, newest, heard, stimulus = None, None, 0, None, [0.0]
    seen, ticks = set(), []
    for now_us in range(PERIOD_US, end_us, PERIOD_US):
        tick = {"now_us": now_us, "position_m": [place(now_us)], "newest": confirmed, "arrives": []}
        for kind, sequence, t_us, content, why in script.get(now_us, []):
            body = msgpack.packb([t_us, content])
            data = msgpack.packb([1, kind, SESSION, sequence, body])
            tick["arrives"].append({"hex": data.hex(), "why": why})
            is_new, is_copy = sequence > newest, sequence in seen
            seen.add(sequence)
            newest = max(newest, sequence)
            if t_us > now_us or is_copy:
                continue
            if kind == FORCE and sequence > (applied or 0):
                try:
                    receiver.decode(t_us, content)
                except Refused:
                    continue
                applied = confirmed = sequence
                heard = t_us, now_us
            elif kind == KEEPALIVE and is_new and applied is not None and content is not None and content <= applied:
                confirmed = sequence
        receiver.applied(now_us, tick["position_m"])  # the tool moves
        if heard is not None:
            at_us = heard[0] + max(0, now_us - heard[1] - PERIOD_US)
            stimulus = receiver.applied(at_us)
        tick["stimulus_n"] = list(stimulus)
        ticks.append(tick)
    return {"name": name, "codec": codec, "parameters": {}, **LAW, "rate_hz": 1e6 / PERIOD_US, "ticks": ticks}


WHY = {
    1000: "the first",
    46_000: "after 45 ms of silence; FORCE 1 was lost, so it confirms nothing to this master",
    102_000: "the repair of FORCE 1 after 100 ms",
    303_000: "FORCE 4 was lost, too: repaired after 200 ms",
    321_000: "another force",
    333_000: "another force, though FORCE 10 is not acknowledged",
    343_000: "the repair of FORCE 10, which is not acknowledged: the round trip was 7 ms, its deviation 3.5 ms",
}
PLACES = {1000: 0.022, 321_000: 0.023, 333_000: 0.024}
ACKNOWLEDGED = {310_000: 9, 350_000: 12}


def slave_trace(end_us):
    """Deadband and Replace of docs/refer/protocol.md, for a master that FORCE 1, 4, 10 and 11 do not reach."""
    entries, waiting = [], []
    x, newest, held, force = 0.0, None, None, None
    sequence, spoke_us, since_us, timeout_us, smoothed_us, deviation_us = 0, 0, 0, 100_000, None, 0
    for now_us in range(PERIOD_US, end_us, PERIOD_US):
        x, newest = PLACES.get(now_us, x), ACKNOWLEDGED.get(now_us, newest)
        place = single(x)
        body = msgpack.packb([now_us, newest, place])
        arrives = msgpack.packb([1, 4, SESSION, now_us // PERIOD_US, body])
        covered = [sent_us for number, sent_us in waiting if newest is not None and number <= newest]
        if covered:
            waiting = waiting[len(covered) :]
            since_us = max(since_us, waiting[0][1]) if waiting else since_us
            round_trip_us = now_us - covered[-1]
            if smoothed_us is None:
                smoothed_us, deviation_us = round_trip_us, round_trip_us / 2
            else:
                deviation_us += (abs(round_trip_us - smoothed_us) - deviation_us) / 4
                smoothed_us += (round_trip_us - smoothed_us) / 8
            timeout_us = smoothed_us + max(5000, 4 * deviation_us)
        stimulus = 300.0 * max(0.0, struct.unpack(">f", place)[0] - 0.02)
        is_due = bool(waiting) and now_us - since_us > timeout_us
        if is_due:
            since_us, timeout_us = now_us, min(2 * timeout_us, 1_000_000)
        answer = None
        if held is None or is_due or abs(stimulus - held) > max(0.05 * abs(held), 0.025):
            sequence = force = sequence + 1
            since_us = since_us if waiting else now_us
            waiting.append((sequence, now_us))
            held = struct.unpack(">f", single(stimulus))[0]
            answer = FORCE, [now_us, single(stimulus)]
        elif now_us - spoke_us >= 45_000:
            sequence += 1
            answer = KEEPALIVE, [now_us, force]
        entry = {"now_us": now_us, "arrives": arrives.hex(), "answer": None}
        if answer is not None:
            spoke_us = now_us
            entry["answer"] = msgpack.packb([1, answer[0], SESSION, sequence, msgpack.packb(answer[1])]).hex()
            entry["why"] = WHY.get(now_us, "")
        entries.append(entry)
    return entries


def document():
    return {
        "note": NOTE,
        "traces": [
            trace("loss, copies and disorder", "deadband", swing, WITH_LOSS, 30_000),
            trace("positions before the first force", "motion-predictive", ramp, FIRST_POSITIONS, 60_000),
            trace("positions before the first force, to and fro", "motion-predictive", swing, FIRST_POSITIONS, 60_000),
            trace("direction before the first force", "passive-extrapolative", stops, {20000: WITH_LOSS[3000]}, 30_000),
        ],
        "slave": slave_trace(400_000),
    }


if __name__ == "__main__":
    FILE.write_text(json.dumps(document(), indent=1) + "\n", encoding="utf-8")
