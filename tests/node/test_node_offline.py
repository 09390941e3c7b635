"""The cost of a codec on a recording is the cost it has in a session."""

from dataclasses import replace

import numpy as np
import pytest

from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.node.offline import cost_report
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import Welcome
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind, pack, pack_body

CODECS = every_codec()

LAW = WeberLaw()


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
    welcome = Welcome(0xFFFF_FFFF, pack_body(context.grant))
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
