"""A sealed session of the C master whose sequence numbers run out; the rest is in peers/conformance."""

import ctypes

from test_c_sessions import Pair

from hapticnet.protocol.seal import LAST_SEQUENCE
from tests.peers import KEY


def test_a_session_whose_numbers_run_out_is_replaced_by_another(lib):
    pair = Pair(lib, "slow", key=KEY)
    pair.run(0.5)
    for loop in pair.loops:
        session = loop.slave.contexts[0].session
        loop.number, session.seal.receive_epoch = session.number, (LAST_SEQUENCE - 40_000) >> 20
    pair.of_python.master.session._stream.seal.send_epoch = (LAST_SEQUENCE - 40_000) >> 20
    lib.shim_set_epoch(pair.of_c.master._keys, (LAST_SEQUENCE - 40_000) >> 20)
    pair.of_python.master.session._stream.sequence = LAST_SEQUENCE - 33_000
    lib.shim_set_sequence(pair.of_c.master.pointer, ctypes.c_uint32(LAST_SEQUENCE - 33_000))
    pair.run(1.5)
    pair.check(least_n=3.0)
    for loop in pair.loops:
        assert [context.session.number != loop.number for context in loop.slave.contexts] == [True]
