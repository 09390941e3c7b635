"""Two hosts: network namespaces joined by a veth pair; the slave is restarted, the master gets a new address."""

import json
import os
import shutil
import subprocess
import uuid

import pytest

from hapticnet.recordings.text import read_csv
from tests.integration.conftest import write_keys

SLAVE_IP, MASTER_IP, OTHER_MASTER_IP = "10.231.47.1", "10.231.47.2", "10.231.47.3"


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
    of_slave, of_master = write_keys(tmp_path)
    in_slave, in_master = (("ip", "netns", "exec", host) for host in hosts)
    address, record = f"{SLAVE_IP}:47800", tmp_path / "master.csv"
    first = start("slave", "--listen", address, *of_slave, prefix=in_slave)
    first.wait_for("listening on")
    options = ("--duration", "60", "--insertions", "50", "--record", str(record), "--json")
    master = start("master", "--connect", address, *of_master, *options, prefix=in_master)
    master.wait_for("connected to")
    first.process.kill()
    first.process.wait()
    master.wait_for("link stale")
    second = start("slave", "--listen", address, *of_slave, "--json", prefix=in_slave)
    master.wait_for("connected to", count=2)
    second.wait_for("joined from")
    assert master.end() == 0, master.said()
    assert second.end() == 0
    report = master.report()
    assert report["connections"] == 2
    assert report["sealed"]
    assert second.report()["sessions"][0]["steps"] > 0
    table = read_csv(record)
    assert table["held_n"].max() <= 5.0


def test_a_master_that_gets_another_address_goes_on_in_its_session(hosts, start, tmp_path):
    of_slave, of_master = write_keys(tmp_path)
    _, master_host = hosts
    in_slave, in_master = (("ip", "netns", "exec", host) for host in hosts)
    server = start("slave", "--listen", "0.0.0.0:47800", *of_slave, "--json", prefix=in_slave)
    server.wait_for("listening on")
    arguments = ("--connect", f"{SLAVE_IP}:47800", *of_master, "--insertions", "1", "--device", "none", "--json")
    master = start("master", *arguments, prefix=in_master)
    server.wait_for(f"'finger' .* joined from {MASTER_IP}")
    link = json.loads(subprocess.run(["ip", "-n", master_host, "-j", "link"], check=True, capture_output=True).stdout)
    device = next(each["ifname"] for each in link if each["ifname"] != "lo")
    ip("-n", master_host, "addr", "del", f"{MASTER_IP}/24", "dev", device)
    ip("-n", master_host, "addr", "add", f"{OTHER_MASTER_IP}/24", "dev", device)
    assert master.process.wait(30) == 0, master.said()
    assert server.end() == 0
    assert master.report()["connections"] == 1
    (session,) = server.report()["sessions"]
    assert session["address"].startswith(f"{OTHER_MASTER_IP}:")
    assert session["end_reason"] == "the master closed: done"
    assert session["breaches"] == 3
