import json
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).parents[2] / "bench"
QUICK = {"UDP", "TCP", "hapticnet, raw", "hapticnet, few positions, sealed"}


@pytest.fixture
def tools(monkeypatch):
    """Make the modules of bench/measure importable."""
    monkeypatch.syspath_prepend(BENCH / "measure")


@pytest.fixture(scope="module")
def linked(measured, tool_is_missing):
    """Return how to get the results of a benchmark that makes network namespaces."""
    if shutil.which("ip") is None:
        tool_is_missing("iproute2 is not installed")
    if os.geteuid():
        pytest.skip("network namespaces need root")
    for kind in (["netns", "add"], ["netns", "del"]):
        name = f"hn-probe-{os.getpid()}"
        if subprocess.run(["ip", *kind, name], capture_output=True, check=False).returncode:
            tool_is_missing("this machine allows no network namespaces")
    if not os.path.exists("/dev/net/tun"):
        tool_is_missing("this machine has no /dev/net/tun")
    return measured


@pytest.fixture(scope="module")
def results(linked):
    return linked("peers")


@pytest.fixture(scope="module")
def doors(linked):
    """Return the rows of a quick run of doors, by link and name."""
    places = linked("doors")["places"]
    return {place["link"]: {row["stack"]: row for row in place["rows"]} for place in places}


@pytest.mark.timeout(300)  # ten measurements, on a machine that may be busy
def test_the_same_work_is_measured_over_each_stack(results):
    rows = {row["stack"]: row for row in results["quiet"]}
    assert set(rows) == QUICK
    assert all(row["runs"] for row in rows.values())
    assert rows["UDP"]["bytes"] == pytest.approx(72.0, abs=4.0), "8 bytes and 28 of headers, each way"
    assert rows["UDP"]["packets"] == pytest.approx(2.0, abs=0.1)
    assert rows["TCP"]["bytes"] > rows["hapticnet, raw"]["bytes"] > rows["UDP"]["bytes"]
    assert rows["hapticnet, few positions, sealed"]["bytes"] < 20.0
    for row in rows.values():
        assert 0.0 < row["p50_us"] <= row["p99_us"]
        assert row["p50_ratio"] > 0.0
        assert min(row["cpu_near_us"], row["cpu_far_us"]) > 0.0


@pytest.mark.timeout(300)
def test_the_lossy_link_delays_and_drops(results):
    (at,) = results["lossy"]
    assert at["loss"] == 0.05
    rows = {row["stack"]: row for row in at["rows"]}
    for name in ("UDP", "hapticnet, raw"):
        assert 0.8 < rows[name]["answers"] < 1.1
        assert rows[name]["p50_us"] > 2000.0 * results["delay_ms"]
        assert rows[name]["age_p99_ms"] >= rows[name]["age_p50_ms"] > 2.0 * results["delay_ms"]


@pytest.mark.timeout(500)  # ten doors, twice
def test_each_door_is_measured_beside_what_its_community_uses(doors):
    clean, lossy = doors["clean"], doors["25 ms each way, 2 % loss"]
    for rows in (clean, lossy):
        assert all(row["runs"] for row in rows.values())
        assert rows["hapticnet, raw"]["bytes_ratio"] == 1.0
        assert rows["ROS 2 topics"]["bytes_ratio"] > 2.0
        assert rows["JSON WebSocket"]["bytes_ratio"] > 1.5
        assert rows["hapticnet, motion-predictive, predicted, few positions"]["bytes_ratio"] < 0.1
    for hz in (30, 60):
        row = clean[f"LeRobot loop, {hz} Hz"]
        assert 2.0 * hz < 1000.0 * row["packets"] < 5.0 * hz, "a message each way, and what acknowledges it"
        assert row["age_p99_ms"] > 1000.0 / hz
    for row in lossy.values():
        assert row["p50_us"] is None or row["p50_us"] > 50_000.0
        assert 0.0 <= row["wrong_least"] <= row["wrong"] <= row["wrong_most"] <= 1.0


@pytest.mark.timeout(500)
@pytest.mark.usefixtures("doors", "results")
def test_the_page_has_every_figure(folder):
    records = {name: json.loads((folder / f"{name}.json").read_text()) for name in ("doors", "peers")}
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH / "report")
        import pages

        made, _ = pages.render(BENCH / "report", records, "peers.md")
        alone, _ = pages.render(BENCH / "report", {"peers": records["peers"]}, "peers.md")
    (text,) = made.values()
    assert "LeRobot loop" in text
    assert "LeRobot loop" not in alone["peers.md"]
    assert not re.search(r"{{|{%|\bnan\b|None|Undefined", text)
    for name in QUICK:
        assert f"| {name} |" in text
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1


def test_without_root_there_is_one_line():
    script = BENCH / "measure" / "peers.py"
    code = f"import os, runpy; os.geteuid = lambda: 1000; runpy.run_path({str(script)!r}, run_name='__main__')"
    environment = os.environ | {"PYTHONPATH": f"{BENCH / 'measure'}:{BENCH.parent}"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith("need root: run this with sudo, or as root")
    assert "Traceback" not in done.stderr


@pytest.mark.usefixtures("tools")
@pytest.mark.parametrize("loss", [0.0, 0.25])
def test_a_direction_of_the_link_keeps_the_order_and_its_random_numbers(loss):
    from lossy_link import Direction

    def passed():
        near, source = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        target, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        for each in (source, far):
            each.setblocking(False)
        arrived = []
        with near, source, target, far:
            direction = Direction(source.fileno(), target.fileno(), 0.02, loss, "1 out")
            for number in range(100):
                near.send(bytes([number]))
                direction.take_in()
                direction.deliver(0.0)
            with pytest.raises(BlockingIOError):
                far.recv(1)
            for due_s in iter(lambda: direction.due_s, None):
                direction.deliver(due_s)
                arrived.append(far.recv(1)[0])
        return arrived

    arrived = passed()
    assert arrived == sorted(arrived) == passed()
    assert len(arrived) == 100 if loss == 0.0 else 60 < len(arrived) < 90


@pytest.mark.usefixtures("tools")
def test_felt_age_counts_back_to_the_newest_position_at_which_the_force_was_right():
    from peer_felt import felt_ticks

    true_n = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 9.0])
    held_n = np.array([0.0, 0.0, 1.0, 1.04, 3.14, 5.0])
    assert felt_ticks(true_n, held_n).tolist() == [0, 1, 1, 2, 0, -1]
