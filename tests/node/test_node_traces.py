"""Golden traces: what both ends do with what arrives, through losses and before the first force."""

import json
from pathlib import Path

import numpy as np
import pytest

from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import UserOperator
from hapticnet.protocol.messages import unpack_position
from hapticnet.scene.settings import Tissue
from tests.node.undisturbed import HERE, SESSION, slave_of_session
from tests.peers import GRANT, HandMaster, HandSlave
from tests.vectors import make_traces

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "traces.json").read_text())


def test_the_traces_are_those_of_the_document():
    assert make_traces.document() == VECTORS


@pytest.mark.parametrize("trace", VECTORS["traces"], ids=lambda trace: trace["name"])
def test_a_master_follows_a_golden_trace(trace):
    places = {tick["now_us"]: tick["position_m"] for tick in trace["ticks"]}

    class Hand:
        axes = 1

        def sample(self, t_us):
            return places[t_us]

    settings = MasterSettings(codec=trace["codec"], rate_hz=trace["rate_hz"])
    master = MasterNode(UserOperator(Hand()), None, settings, np.random.default_rng(1))
    slave = HandSlave(master).connect(grant=GRANT._replace(session=SESSION))
    for tick in trace["ticks"]:
        now_us = tick["now_us"]
        master.tick(now_us)
        (position,) = slave.said()
        assert unpack_position(position.body).newest == tick["newest"], now_us
        for arrival in tick["arrives"]:
            master.receive_datagram(bytes.fromhex(arrival["hex"]), now_us)
        master.drive(now_us)
        assert list(master.received_n) == tick["stimulus_n"], now_us


def test_a_slave_follows_a_golden_trace():
    spring = Tissue(name="spring", rest_position_m=0.02, stiffness_n_per_m=300.0, breach_force_n=1e6)
    slave = slave_of_session((spring,))
    HandMaster(slave, HERE).join()
    for entry in VECTORS["slave"]:
        slave.receive_datagram(bytes.fromhex(entry["arrives"]), HERE, entry["now_us"])
        answers = [data.hex() for data, _ in slave.datagrams_to_send()]
        assert answers == [entry["answer"]] * (entry["answer"] is not None), entry
