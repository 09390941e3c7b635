"""The felt force: what is applied at each tick over a network, beside the true force of that tick."""

from dataclasses import replace

import numpy as np
import pytest

from hapticnet.channel.settings import BernoulliLoss, ChannelSettings
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.experiment.analysis import felt_error
from hapticnet.experiment.trials import paper_trial
from hapticnet.measure.metrics import error_report
from hapticnet.node.closed_loop import Felt, simulate_link
from hapticnet.node.offline import cost_report
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import Welcome, pack_contents
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind, pack, pack_body

CODECS = every_codec()
LAW = WeberLaw()
PAPER = paper_trial(1, rate_hz=1000.0, insertions=1)
LOSSLESS_CODECS = [name for name in CODECS if not make_codec(name, LAW).needs_position]


def felt(name: str, delay_us: int = 0, loss: float = 0.0, seed: int = 1, repair_us: int = 20_000) -> Felt:
    one_way = ChannelSettings(delay_us=delay_us)
    lossy = ChannelSettings(delay_us=delay_us, loss=BernoulliLoss(loss) if loss else None)
    return simulate_link(
        make_codec(name, LAW),
        PAPER.t_us,
        PAPER.stimuli,
        PAPER.positions,
        forward=one_way,
        feedback=lossy,
        repair_us=repair_us,
        rng=np.random.default_rng(seed),
    )


@pytest.mark.parametrize("name", CODECS)
def test_without_delay_and_loss_it_is_what_the_codec_applies(name):
    encoding = encode_array(make_codec(name, LAW), PAPER.t_us, PAPER.stimuli, PAPER.positions)
    result = felt(name)
    assert np.array_equal(result.applied, encoding.decoded)
    assert result.sent == result.received == len(encoding.sent)


@pytest.mark.parametrize("delay_us", [1_500, 10_000])
def test_the_uncompressed_force_is_late_by_the_round_trip(delay_us):
    late = 2 * delay_us // 1000
    applied = felt("raw", delay_us).applied
    assert np.array_equal(applied[late:], PAPER.stimuli[:-late].astype(np.float32))
    assert not applied[:late].any()


@pytest.mark.parametrize("name", LOSSLESS_CODECS)
def test_with_delay_the_same_stimuli_are_applied_later(name):
    assert np.array_equal(felt(name, 5_000).applied[10:], felt(name).applied[:-10])


def test_positions_and_forces_that_are_overtaken_are_left_out():
    reordered = ChannelSettings(delay_us=2_000, reorder_probability=0.2)
    codec = make_codec("raw", LAW)
    arguments = {"forward": reordered, "feedback": reordered, "repair_us": 0, "rng": np.random.default_rng(3)}
    result = simulate_link(codec, PAPER.t_us, np.arange(len(PAPER.t_us), dtype=np.float64)[:, None], **arguments)
    assert (np.diff(result.applied[:, 0]) >= 0.0).all()
    assert result.received < result.sent < len(PAPER.t_us)


def test_a_lost_update_is_replaced_once_it_is_known_to_be_lost():
    lossless = error_report(LAW, PAPER.stimuli, felt("deadband").applied).exceed_jnd_fraction
    soon, late, never = (
        error_report(LAW, PAPER.stimuli, felt("deadband", loss=0.3, repair_us=each).applied).exceed_jnd_fraction
        for each in (2_000, 50_000, 10**9)
    )
    assert lossless == 0.0 < soon < late < never


def test_it_agrees_with_a_session_in_virtual_time():
    import hapticnet as hn

    link = hn.virtual_link(scene="paper:1", codec="raw", forward="delay=10ms", feedback="delay=10ms", seed=1)
    link.run(seconds=4.0)
    session = felt_error(LAW, link.slave_samples(), link.master_samples())
    alone = felt("raw", 10_000).applied[:4000]
    expected = error_report(LAW, PAPER.stimuli[:4000], alone)
    assert session.exceed_jnd_fraction == pytest.approx(expected.exceed_jnd_fraction, abs=0.03)


@pytest.mark.parametrize("name", sorted(CODECS))
def test_offline_and_session_agree_on_packets_bytes_and_errors(loopback, name):
    link = loopback(6, settings=MasterSettings(codec=name, law=LAW, record=True), start_us=1 << 20)
    link.run(3_000_000)
    (context,) = link.slave.contexts
    table, session = context.recording.table(), context.report()
    forces = table["force_n"][:, np.newaxis]
    t_us = table["t_us"].astype(np.int64)
    codec = make_codec(name, LAW)
    positions = table["position_m"][:, np.newaxis]
    report = cost_report(codec, t_us, forces, encode_array(codec, t_us, forces, positions))
    assert report.sent == context.session.sent.by_kind[Kind.FORCE]
    assert report.packet_rate_reduction == session["packet_rate_reduction"]
    # Sequence numbers below 2¹⁶ take fewer bytes, and keepalives share them: at most two bytes a packet apart.
    assert report.payload_bytes == pytest.approx(
        table["datagram_bytes"][table["transmitted"] > 0].sum(), abs=2 * report.sent
    )
    said = replace(context.session.sent)
    assert report.keepalives == said.by_kind[Kind.KEEPALIVE]
    welcome = Welcome(0xFFFF_FFFF, pack_contents(context.grant))
    handshake_bytes = len(pack(Kind.WELCOME, context.session.number, 0, pack_body(welcome))) + UDP_IPV4_HEADER_BYTES
    assert report.session_wire_bytes == said.wire_bytes - handshake_bytes
    assert report.rmse_n == pytest.approx(session["rmse_n"])
    assert report.exceed_jnd_fraction == session["exceed_jnd_fraction"]


def test_raw_saves_nothing_and_an_empty_recording_costs_nothing():
    codec = make_codec("raw", LAW)
    t_us, forces = np.arange(5) * 1000, np.arange(5.0)[:, np.newaxis]
    report = cost_report(codec, t_us, forces, encode_array(codec, t_us, forces))
    assert (report.packet_rate_reduction, report.wire_byte_reduction) == (0.0, 0.0)
    assert report.worst_100ms_packets == 5
    nothing = np.empty((0, 1))
    report = cost_report(codec, t_us[:0], nothing, encode_array(codec, t_us[:0], nothing))
    assert (report.samples, report.sent, report.wire_bytes) == (0, 0, 0)
