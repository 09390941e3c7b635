"""A slave with a bank sends the same bytes and keeps the same accounts as one without, whatever arrives."""

import pytest

from tests.node.twins import Crowd, Twins

NETWORKS = {
    "perfect": "perfect",
    "delay and jitter": "delay=8ms,jitter=normal:2ms",
    "losses in bursts": "delay=12ms,loss=gilbert:2%,25%",
    "reordering and copies": "delay=5ms,jitter=normal:3ms,order=free,duplicate=10%,reorder=5%:4ms,loss=2%",
}


@pytest.mark.parametrize("network", NETWORKS)
def test_compiled_sessions_send_the_same_bytes(network):
    twins = Twins(1)
    crowd = Crowd(twins, 1, network=NETWORKS[network])
    crowd.run(1500)
    assert len(twins.banked._bank) == 12
    twins.check_reports()
    twins.close(crowd.slaves_us)
    twins.check_reports()
    assert twins.datagrams > 5_000
