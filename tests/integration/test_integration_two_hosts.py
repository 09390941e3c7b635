"""Two hosts: network namespaces joined by a veth pair, the slave killed and started again mid-run."""

import os
import shutil
import subprocess
import uuid

import pytest

from hapticnet.recordings.tables import read_csv

SLAVE_IP, MASTER_IP = "10.231.47.1", "10.231.47.2"


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@pytest.fixture
def hosts(tool_is_missing):
    """Return the names of two namespaces that can reach each other."""
    if shutil.which("ip") is None:
        tool_is_missing("iproute2 is not installed")
    tag = uuid.uuid4().hex[:6]
    one, other = f"hn-slave-{tag}", f"hn-master-{tag}"
    try:
        ip("netns", "add", one)
    except subprocess.CalledProcessError:
        if os.geteuid() == 0:
            tool_is_missing("this machine allows no network namespaces")
        pytest.skip("network namespaces need root")
    try:
        ip("netns", "add", other)
        ip("link", "add", f"va{tag}", "netns", one, "type", "veth", "peer", "name", f"vb{tag}", "netns", other)
        for name, device, address in ((one, f"va{tag}", SLAVE_IP), (other, f"vb{tag}", MASTER_IP)):
            ip("-n", name, "addr", "add", f"{address}/24", "dev", device)
            ip("-n", name, "link", "set", device, "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield one, other
    finally:
        for name in (one, other):
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def test_a_killed_slave_comes_back_and_the_held_force_never_outlives_its_age_limit(hosts, start, tmp_path):
    slave_host, master_host = hosts
    in_slave, in_master = ("ip", "netns", "exec", slave_host), ("ip", "netns", "exec", master_host)
    address, record = f"{SLAVE_IP}:47800", tmp_path / "master.csv"
    first = start("slave", "--listen", address, prefix=in_slave)
    first.wait_for("listening on")
    assert "not encrypted" in first.said()
    master = start(
        "master",
        "--connect",
        address,
        "--duration",
        "60",
        "--insertions",
        "50",
        "--record",
        str(record),
        "--json",
        prefix=in_master,
    )
    master.wait_for("connected to")
    first.process.kill()
    first.process.wait()
    master.wait_for("link stale")
    second = start("slave", "--listen", address, "--json", prefix=in_slave)
    master.wait_for("connected to", count=2)
    second.wait_for("joined from")
    assert master.end() == 0, master.said()
    assert second.end() == 0
    report = master.report()
    assert report["connections"] == 2
    assert second.report()["sessions"][0]["steps"] > 0
    table = read_csv(record)
    assert table["held_n"].max() <= 5.0
