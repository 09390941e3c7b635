"""The table of peers/README.md says what the suite found, and what the peers say now."""

import json

from conformance import damage, golden
from conformance.child import find_peers
from conformance.table import BEGIN, END, README, RESULTS, render

FOUND = json.loads(RESULTS.read_text())


def test_the_table_is_made_from_the_results():
    """After a change: make conformance; or python -m conformance.table --render if only a length has changed."""
    assert README.read_text().partition(BEGIN)[2].partition(END)[0].strip() == render(FOUND)
    assert set(FOUND) == {peer.folder.name for peer in find_peers()}


def test_a_peer_has_what_the_table_says(child):
    """After a change: make conformance."""
    assert FOUND[child.peer.folder.name]["features"] == child.features


def test_every_vector_and_damaged_datagram_of_the_suite_is_counted(child):
    agreed = FOUND[child.peer.folder.name]["agreed"]
    codecs = sum(child.has("codecs", case["codec"]) for case in golden.read("codecs")["cases"])
    traces = [each for each in golden.read("traces")["traces"] if child.has("codecs", each["codec"])]
    of_master = golden.conversation()[0] + golden.sealed()[0] + sum(len(trace["ticks"]) for trace in traces) + codecs
    of_master += len(list(golden.refused_by_masters()))
    refused = golden.read("refused")
    to_slave = sum(each["to"] == "slave" for each in refused["datagrams"])
    of_slave = len(refused["requests"]) + to_slave + len(golden.read("traces")["slave"])
    assert agreed["vectors"] == of_master + of_slave
    assert agreed["malformed"] == 2 * damage.SEEDS * damage.ROUNDS * damage.EACH_ROUND
