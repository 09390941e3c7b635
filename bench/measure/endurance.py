"""A session of 24 simulated hours with loss, and one that passes 2³²: memory, drift, and what wraps.

Both nodes run in virtual time, open and sealed. The operator repeats the same motion, so the forces of a cycle without
loss at the end must equal those of one at the beginning.
"""

import argparse
import math
import time
from collections import Counter
from typing import Any, Final

import numpy as np
import record
from fuzz import resident_mb

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.seal import EPOCH_BITS
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene

SECOND: Final = 1_000_000
CYCLE_US: Final = 4 * SECOND
QUIET_US: Final = 5 * CYCLE_US
"""Time without loss at the beginning and at the end."""

LOSSY: Final = "delay=20ms,jitter=uniform:5ms,loss=gilbert:1.75%,33%,duplicate=1%,reorder=1%"
QUIET: Final = "delay=20ms"
SLAVE_KEY: Final = PrivateKey(bytes(range(32)))
MASTER_KEY: Final = PrivateKey(bytes(range(1, 33)))
CHECKPOINTS: Final = 24


class Cycle:
    """An operator that goes into the tissue and out of it every four seconds."""

    axes = 1
    duration_us = None

    def sample(self, t_us: int) -> PositionSample:
        turn = t_us % CYCLE_US / CYCLE_US
        return PositionSample(t_us, (0.04 * (1.0 - math.cos(2.0 * math.pi * turn)),))


def session(seed: int, *, sealed: bool, rate_hz: float, start_us: int, first_sequence: int) -> Loopback:
    """Return both nodes with a scene in which time matters: viscosity, friction, and tissue that recovers."""
    forward, feedback, sessions, nonces = np.random.default_rng(seed).spawn(4)
    preset = find_scene("example-viscous")
    settings = SessionSettings(first_sequence=first_sequence)
    roster = Roster([MasterEntry(name="long", public=MASTER_KEY.public)])
    doors: dict[int, Door] = {OPEN: Door()}
    if sealed:
        doors = {SEALED: SealedDoor(SLAVE_KEY.private, roster, sessions)}
    slave = SlaveNode(
        lambda _: Scene(preset.tissues, name=preset.name), SlaveSettings(session=settings), sessions, doors=doors
    )
    key = MasterKey(MASTER_KEY, SLAVE_KEY.public) if sealed else None
    master = MasterNode(Cycle(), None, MasterSettings(rate_hz=rate_hz, key=key, session=settings), nonces)
    return Loopback(
        master,
        slave,
        forward=Emulator(parse_channel(QUIET), forward),
        feedback=Emulator(parse_channel(QUIET), feedback),
        start_us=start_us,
    )


def cycle(loopback: Loopback) -> list[float]:
    """Play one cycle; return the true force at every position."""
    forces = []
    for _ in range(CYCLE_US // loopback.master.period_us):
        loopback.run(loopback.master.period_us)
        (context,) = loopback.slave.contexts
        forces.append(context.scene.force_n)
    return forces


def lasting(
    hours: float, seed: int, *, sealed: bool, rate_hz: float, start_us: int = 0, first_sequence: int = 0
) -> dict[str, Any]:
    """Play a session with loss for some hours; return counters, drift and memory."""
    loopback = session(seed, sealed=sealed, rate_hz=rate_hz, start_us=start_us, first_sequence=first_sequence)
    events: Counter[str] = Counter()
    rng = np.random.default_rng(seed)
    started_s = time.process_time()
    loopback.run(QUIET_US)
    first = cycle(loopback)
    loopback.forward, loopback.feedback = (Emulator(parse_channel(LOSSY), each) for each in rng.spawn(2))
    memory_mb = []
    # Whole cycles, so that the last one is in phase with the first.
    cycles = round(hours * 3600 * SECOND / CYCLE_US / CHECKPOINTS)
    for _ in range(CHECKPOINTS):
        loopback.run(cycles * CYCLE_US)
        memory_mb.append(resident_mb())
        while event := loopback.master.next_event():
            events[type(event).__name__] += 1
    loopback.forward, loopback.feedback = (Emulator(parse_channel(QUIET), each) for each in rng.spawn(2))
    loopback.run(QUIET_US)
    last = cycle(loopback)
    (context,) = loopback.slave.contexts
    master = loopback.master
    newest_us = context.session._position_t_us or 0
    settled = memory_mb[CHECKPOINTS // 2 :]
    return {
        "sealed": sealed,
        "rate_hz": rate_hz,
        "virtual_h": (loopback.now_us - start_us) / 3600 / SECOND,
        "start_us": start_us,
        "first_sequence": first_sequence,
        "positions": context.steps,
        "ended_us": loopback.now_us,
        "time_stamp_wraps": (loopback.now_us >> 32) - (start_us >> 32),
        "sequence_wraps": (first_sequence + context.session.received.packets) >> 32,
        "key_changes": context.session.received.packets >> EPOCH_BITS if sealed else None,
        "connections": events["Connected"],
        "stale": events["LinkStale"],
        "malformed": context.session.received.malformed + master.session.received.malformed,
        "stray": context.session.received.stray + master.session.received.stray,
        "lag_us": loopback.now_us - newest_us,
        "force_difference_n": float(np.max(np.abs(np.subtract(last, first)))),
        "largest_force_n": float(np.max(first)),
        "memory_growth_mb": max(settled) - settled[0],
        "memory_mb": memory_mb,
        "cpu_s": time.process_time() - started_s,
    }


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    arguments.repetitions = 1
    rows = []
    for sealed in (False, True):
        rows.append(lasting(arguments.hours, arguments.seed, sealed=sealed, rate_hz=50.0))
        # Time stamps wrap after half of it, and open sequence numbers soon; sealed ones begin at 0.
        half_us = round(arguments.wrap_hours * 1800 * SECOND)
        first_sequence = 0 if sealed else (1 << 32) - 20_000
        start_us = (1 << 32) - half_us
        wrapping = {"start_us": start_us - start_us % SECOND, "first_sequence": first_sequence}
        rows.append(lasting(arguments.wrap_hours, arguments.seed, sealed=sealed, rate_hz=1000.0, **wrapping))
    return {"lossy": LOSSY, "rows": rows}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--hours", type=record.within(0.01), default=24.0, help="length of the sessions at 50 Hz")
    parser.add_argument("--wrap-hours", type=record.within(0.01), default=0.1, help="of those at 1 kHz that pass 2³²")
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
