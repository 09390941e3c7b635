"""Every number of every message at its edges, at either end of a session, and forces that no true slave would send."""

import itertools
import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.errors import SettingsError
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol import messages as ranges
from hapticnet.protocol.messages import Close, Code, Force, Keepalive
from hapticnet.protocol.wire import Kind, pack_body
from hapticnet.samples import PositionSample
from tests.conftest import make_slave
from tests.node.undisturbed import seal_or_pack
from tests.peers import GRANT, KEY, HandMaster, HandSlave

CODECS = every_codec()
EDGES = (
    *(0, 1, -1, True, None, "1", b"1", 2**16, 2**31, 2**32 - 1, 2**32, 2**53, 2**63, -(2**63), 0.0, -0.0, 0.5, 1.0),
    *(5e-324, 1e-310, 1e-302, 1e-13, 19.999, 20.0, 1e5, 1e6, 1e15, 1e300, 1.7976931348623157e308),
    *(math.inf, -math.inf, math.nan),
)
SEALED_KINDS = (Kind.FORCE, Kind.KEEPALIVE, Kind.CLOSE, Kind.NOTICE)
NUMBERS_OF_REQUEST = ("weber_fraction", "floor_n", "multiplier", "rate_hz", "axes", "clock_us", "position_share")


def master_node(sealed=False, **settings):
    device = SimulatedDevice(PlantSettings(), np.random.default_rng(0))
    operator = ScriptedOperator(InsertionSettings(), np.random.default_rng(1))
    return MasterNode(
        operator, device, MasterSettings(key=KEY if sealed else None, **settings), np.random.default_rng(2)
    )


def ask(master, now_us):
    """Ask for a session through a cookie; return REFUSE, WELCOME or, without an answer, None."""
    answers = [*master.hello(now_us), *master.hello(now_us)]
    if len(answers) < 2:
        return None
    return Kind.REFUSE if master.refusal is not None else answers[1].kind


def use(master, now_us):
    """Move through the tissue in a session that was granted: it works."""
    for step in range(1, 60):
        place = struct.pack(">f", 0.02 + 0.0002 * step)
        master.position(step, now_us + 1000 * step, payload=place, t_us=now_us + 1000 * step)
    context = next(each for each in master.slave.contexts if each.session.number == master.session)
    assert context.steps > 10


NONCES = itertools.count(1)


@pytest.mark.parametrize("field", NUMBERS_OF_REQUEST)
def test_a_request_is_granted_refused_in_words_or_dropped(field, sealed):
    slave = make_slave(sealed=None)
    kinds = set()
    now_us = 0
    for value in EDGES:
        now_us += 1_000_000
        master = HandMaster(slave, f"host {field} {value!r}", sealed=sealed, nonce=next(NONCES), **{field: value})
        kind = ask(master, now_us)
        kinds.add(kind)
        bounds = {"rate_hz": ranges.RATE_HZ, "position_share": ranges.POSITION_SHARE}.get(field)
        if bounds is not None and type(value) in (int, float) and math.isfinite(value):
            assert kind is (Kind.WELCOME if bounds.has(value) else Kind.REFUSE), value
        if kind is Kind.REFUSE:
            assert master.refusal.code in (Code.PARAMETER, Code.AXES)
            assert "must be" in master.refusal.reason or "axes" in master.refusal.reason
        if kind is Kind.WELCOME:
            use(master, now_us)
    assert None in kinds, "what is no number is dropped"
    assert Kind.WELCOME in kinds
    assert slave.session_count <= len(EDGES)


@pytest.mark.parametrize(
    # Compiled, `pack` writes no frame whose session is no number.
    "field",
    [pytest.param("session", marks=pytest.mark.plain), "rate_hz", "keepalive_us", "position_share"],
)
def test_a_grant_is_used_or_counted_as_malformed(field, sealed):
    for value in EDGES:
        master = master_node(sealed, positions="line", position_share=0.5)
        slave = HandSlave(master, sealed=sealed)
        master.tick(0)
        slave.cookie(slave.hello(), 0)
        slave.welcome(slave.hello(), 0, GRANT._replace(**{field: value}))
        report = master.report()
        assert report["received"]["malformed"] + report["received"]["stray"] == (not master.connected), value
        if master.connected:
            assert ranges.RATE_HZ.has(report["rate_hz"])
            assert master.session.position_share in (0.0, 0.5)
        for now_us in range(0, 30_000, 1000):
            master.tick(now_us)
            master.drive(now_us)


@pytest.mark.parametrize("element", range(5))
def test_a_frame_is_read_or_counted(element):
    slave, master = make_slave(sealed=None), master_node()
    HandSlave(master).connect()
    for data in bodies((1, Kind.FORCE, GRANT.session, 7, b"\x90"), element):
        slave.receive_datagram(data, "a", 0)
        master.receive_datagram(data, 0)
    assert slave.session_count == 0
    assert not master.finished


@pytest.mark.parametrize("name", CODECS)
def test_every_parameter_of_every_codec_is_checked(name):
    slave = make_slave(sealed=None)
    known = [each for each in CODECS[name].__dataclass_fields__ if each != "law"]
    now_us = 0
    for key, value in itertools.product(known, EDGES):
        now_us += 1_000_000
        master = HandMaster(slave, f"host {key} {value!r}", nonce=next(NONCES), codec=name, parameters={key: value})
        if ask(master, now_us) is Kind.WELCOME:
            use(master, now_us)


def bodies(fields, at):
    """Return bodies with each edge in place of the field `at`."""
    for value in EDGES:
        try:
            yield pack_body((*fields[:at], value, *fields[at + 1 :]))
        except OverflowError:
            continue


@pytest.mark.parametrize("line", [False, True])
def test_a_position_moves_the_scene_or_is_counted(line, sealed):
    slave = make_slave(sealed=None)
    master = HandMaster(slave, sealed=sealed, nonce=next(NONCES), position_share=0.25 if line else 0.0).join()
    payload = struct.pack(">fe", 0.01, 0.01) if line else struct.pack(">f", 0.01)
    floats = [struct.pack(">f", value) for value in (5e-324, 1e-45, 1e30, -3e38, math.inf, -math.inf, math.nan, -0.0)]
    halves = [struct.pack(">e", value) for value in (6e-8, 65504.0, -65504.0, math.inf, math.nan)]
    payloads = [*floats, *(each + half for each in floats[:3] for half in halves), b"", bytes(3), bytes(1000)]
    sequence = itertools.count(1)
    for at in range(5):
        for body in bodies((1000, None, payload, 50, 50), at):
            master.send(seal_or_pack(master.seal, Kind.POSITION, next(sequence), body, master.session), 1000)
    for number, each in enumerate(payloads):
        now_us = 2000 + 1000 * number
        master.position(next(sequence), now_us, payload=each)
    slave.tick(100_000)
    slave.account_sent(100_000)
    (context,) = slave.contexts
    sent = next(sequence) - 1
    assert context.session.received.packets - 2 <= sent
    assert all(map(math.isfinite, context.newest[1] + context.newest[2])) if context.newest else True


@pytest.mark.parametrize("codec", CODECS)
def test_a_force_is_applied_within_the_limits_or_counted(codec, sealed):
    master = master_node(sealed, codec=codec, announced=True, positions="line")
    slave = HandSlave(master, sealed=sealed)
    slave.connect(grant=GRANT._replace(announced=True, position_share=0.25))
    rng = np.random.default_rng(3)
    singles = [struct.pack(">f", value) for value in (1e-45, 1e-38, 1.0, 3e38, -3e38, math.inf, math.nan)]
    doubles = [struct.pack(">d", value) for value in (5e-324, 1e15, 1.1e15, 1e308, -math.inf, math.nan)]
    bounds = [b"".join(each) for each in itertools.product(singles, repeat=2)] + [b"", bytes(16)]
    now_us, number = 0, 0
    for _ in range(400):
        now_us += 1000
        number += 1
        master.tick(now_us)
        parts = [rng.choice([*singles, *doubles, rng.bytes(2)]) for _ in range(rng.integers(0, 12))]
        payload = bytes([rng.integers(0, 6)]) * int(rng.integers(0, 3)) + b"".join(bytes(part) for part in parts)
        bound = bounds[rng.integers(len(bounds))]
        body = pack_body((now_us, payload, bound))
        slave.master.receive_datagram(seal_or_pack(slave.seal, Kind.FORCE, number, body, slave.session), now_us)
        master.drive(now_us)
        assert all(map(math.isfinite, master.held_n))
        assert 0.0 <= master.target_n <= 5.0
    for at, fields in itertools.product(range(3), [(now_us, b"", b""), (now_us, 5, b"")]):
        for body in bodies(fields, at):
            for kind in (*SEALED_KINDS, Kind.COOKIE, Kind.WELCOME, Kind.REFUSE):
                number += 1
                seal = slave.seal if kind in SEALED_KINDS else None
                slave.master.receive_datagram(seal_or_pack(seal, kind, number, body, slave.session), now_us)
    assert not master.finished


HELD_US = 50_000
EXTREMES = (0.0, -0.0, 1.0, 1e15, -1e15, 9.99e14, 1e300, -1e300, 5e-324, math.nan, math.inf)


def payloads(rng):
    """Return payloads of all lengths: random bytes, and every extreme as float64 and float32."""
    for _ in range(100):
        yield rng.bytes(int(rng.integers(0, 16)))
        extreme = EXTREMES[rng.integers(len(EXTREMES))]
        yield struct.pack(">d", extreme)
        yield struct.pack(">f", min(max(extreme, -3e38), 3e38))
        yield struct.pack(">de", extreme, 65504.0) + rng.bytes(int(rng.integers(0, 4)))


@pytest.mark.parametrize("codec", CODECS)
def test_no_payload_brings_a_master_down_or_presses_harder_than_the_device_may(codec):
    master = master_node(codec=codec)
    slave = HandSlave(master).connect()
    largest_n, held_n = 0.0, set()
    for number, payload in enumerate(payloads(np.random.default_rng(1)), start=1):
        master.tick(HELD_US * number)
        slave.say(Kind.FORCE, number, Force(HELD_US * number, payload), HELD_US * number)
        for now_us in range(HELD_US * number, HELD_US * (number + 1), 1000):
            master.tick(now_us)
            master.drive(now_us)
            held_n.add(master.held_force_n(now_us)[0])
            largest_n = max(largest_n, master._rendering.fingertip.device.contact_force_n)
    received = master.report()["received"]
    assert received["packets"] == number + 2, "COOKIE and WELCOME come first"
    assert 0 < received["malformed"] < number
    assert largest_n <= 5.0
    assert all(map(math.isfinite, held_n))
    assert len(held_n) > 1


def test_the_wire_document_names_every_range():
    text = Path("docs/refer/protocol.md").read_text(encoding="utf-8")
    found = {
        name: (bool(zero), float(low), float(high))
        for name, zero, low, high in re.findall(r"^\| `(\w+)` \| (0 or )?([\d.]+) … ([\d.]+)", text, re.MULTILINE)
    }
    for name, bounds in {
        "rate_hz": ranges.RATE_HZ,
        "position_share": ranges.POSITION_SHARE,
        "keepalive_us": ranges.KEEPALIVE_US,
        "clock_us": ranges.CLOCK_US,
        "sequence": ranges.HELLO_SEQUENCE,
        "share": ranges.PERCENT,
        "again": ranges.PERCENT,
    }.items():
        assert found[name] == (bounds.zero_allowed, bounds.smallest, bounds.largest), name


@pytest.mark.parametrize(
    ("codec", "payload"),
    [("linear-predictive", struct.pack(">ff", 1.0, 5.0)), ("adaptive-predictive", struct.pack(">fe", 1.0, 10.0))],
)
def test_a_line_stays_at_its_end_however_long_no_other_update_comes(codec, payload):
    master = master_node(codec=codec)
    slave = HandSlave(master).connect()
    master.tick(0)
    slave.say(Kind.FORCE, 1, Force(0, payload), 1000)
    for number, now_us in enumerate(range(100_000, (1 << 32) + 10_000_000, 100_000), start=2):
        master.tick(now_us)
        slave.say(Kind.KEEPALIVE, number, Keepalive(now_us & 0xFFFF_FFFF, 1), now_us)
        master.drive(now_us)
        if now_us > 300_000:
            assert master.held_force_n(now_us)[0] == pytest.approx(1.5)


class Steady:
    """A hand that moves at 80 mm/s."""

    axes = 1
    duration_us = None

    def sample(self, t_us):
        return PositionSample(t_us, (80e-9 * t_us,))


@pytest.mark.parametrize("late_us", [0, 80_000])
def test_a_decoder_knows_the_motion_of_the_hand_when_the_first_force_arrives(late_us):
    viscous = bytes([3]) + struct.pack(">ffee", 1.0, 0.0, 0.0, 10.0)  # 1 N, and 10 N·s/m times the velocity
    settings = MasterSettings(codec="motion-predictive", record=True)
    master = MasterNode(Steady(), None, settings, np.random.default_rng(2))
    slave = HandSlave(master).connect()
    decoder = make_codec("motion-predictive", WeberLaw()).decoder(1)
    for now_us in range(0, 200_000, 1000):
        master.tick(now_us)
        if now_us == 50_000 + late_us:
            slave.say(Kind.FORCE, 1, Force(50_000, viscous), now_us)
            decoder.decode(50_000, viscous)
        master.drive(now_us)
        expected_n = decoder.reconstruct(now_us, master.position_m, now_us)
        assert master.received_n == expected_n
    assert expected_n[0] == pytest.approx(1.8, rel=1e-3)


@pytest.mark.parametrize("rate_hz", [20.0, 31.0, 137.0, 333.0, 999.0, 1e5])
def test_a_device_is_driven_at_its_own_rate_and_positions_are_sent_at_the_granted_one(rate_hz):
    device = SimulatedDevice(PlantSettings(), np.random.default_rng(0))
    settings = MasterSettings(record=True)
    master = MasterNode(Steady(), device, settings, np.random.default_rng(2))
    HandSlave(master).connect(grant=GRANT._replace(rate_hz=rate_hz))
    assert master.period_us == 1000
    sent_us = []
    master.datagrams_to_send()
    for now_us in range(0, 190_000, 1000):
        master.tick(now_us)
        sent_us += [now_us for _ in master.datagrams_to_send()]
        master.drive(now_us)
    granted_us = max(1e6 / rate_hz, 1000.0)
    due_us = np.arange(len(sent_us)) * granted_us
    assert len(sent_us) == 1 + int(189_500 // granted_us)
    assert np.abs(sent_us - due_us).max() <= 1000.0, "within a tick of when they are due"
    assert master.report()["rate_hz"] == pytest.approx(min(rate_hz, 1000.0), rel=1e-3)


def test_a_keepalive_of_a_new_session_does_not_confirm_the_force_of_an_earlier_one():
    master = master_node()
    slave = HandSlave(master).connect()
    master.tick(0)
    slave.say(Kind.FORCE, 1, Force(0, struct.pack(">f", 1.0)), 1000)
    slave.say(Kind.CLOSE, 2, Close("restarts"), 2000)
    master.session.datagrams_to_send()
    slave.connect(200_000)
    for number, now_us in enumerate(range(200_000, 800_000, 10_000), start=1):
        master.tick(now_us)
        slave.say(Kind.KEEPALIVE, number, Keepalive(now_us, None), now_us)
        master.drive(now_us)
    assert master.held_force_n(800_000)[0] == 0.0


@pytest.mark.parametrize("name", ["", " ", "a\nb", "x" * 65])
def test_a_name_that_no_list_could_have_is_refused_and_not_cut_off(name):
    with pytest.raises(SettingsError, match="it must be 1 to 64 printable bytes"):
        MasterSettings(name=name)
