"""Measure what README.md says: a leader and a robot over plain topics, and through hapticnet, in one run.

python extras/ros2/compare_topics.py       # Linux, as root: it makes a network of its own, to count the bytes of DDS

A leader and a robot with loops of 1 kHz, each a process, and a spring of 400 N/m. First small steps, to see how long
the force takes to come back; then a hand that presses. Bytes are those between the two places, with IP and UDP headers.
"""

import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from cyclonedds.core import Qos
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from hapticnet_ros2.messages import PoseStamped, WrenchStamped, made
from hapticnet_ros2.topics import BEST_EFFORT, TOPIC, participant

STIFFNESS = 400.0  # N/m
BASE_M = 0.0005  # pressed in before the steps
DEEPEST_M = 0.008  # that the hand presses afterwards
STEP_M = 0.00025
STEP_S, STEPS, PRESS_S, WARM_S = 0.1, 60, 10.0, 5.0
ETHERNET = 14  # bytes that Linux counts on its loopback besides IP, UDP and what they carry
ADDRESS = "127.0.0.1:47899"
WAYS: dict[str, list[str] | None] = {
    "plain topics": None,
    "hapticnet, deadband": ["--codec", "deadband"],
    "hapticnet, motion-predictive": ["--codec", "motion-predictive"],
}


def topic(name: str, kind: type) -> Topic[Any]:
    """Return a topic of ROS's in the network of this measurement."""
    return Topic(participant(0, "lo"), f"rt/{name}", kind, qos=TOPIC)


def reader(name: str, kind: type, qos: Qos = BEST_EFFORT) -> DataReader[Any]:
    """Return a reader of a topic."""
    return DataReader(participant(0, "lo"), topic(name, kind), qos=qos)


def writer(name: str, kind: type) -> DataWriter[Any]:
    """Return a writer to a topic."""
    return DataWriter(participant(0, "lo"), topic(name, kind), qos=BEST_EFFORT)


def robot() -> None:
    """Be a robot that moves at once and feels a spring."""
    commands = reader("R/servo_cp", PoseStamped)
    places, forces = writer("R/measured_cp", PoseStamped), writer("R/measured_cf", WrenchStamped)
    z_m, due_s = 0.0, time.monotonic()
    while True:
        for command in commands.take(1):
            if command.sample_info.valid_data:
                z_m = command.pose.position.z
        places.write(made(PoseStamped, (0.0, 0.0, z_m, 0.0, 0.0, 0.0, 1.0), "base"))
        forces.write(made(WrenchStamped, (0.0, 0.0, -STIFFNESS * z_m), "base"))
        due_s += 0.001
        time.sleep(max(due_s - time.monotonic(), 0.0))


def wanted_m(at_s: float) -> float:
    """Return where the hand is."""
    if at_s < 0.0:
        return 0.0
    if at_s < STEP_S * STEPS:
        return BASE_M * min(at_s / STEP_S, 1.0) + STEP_M * (int(at_s / STEP_S) % 2)
    return BASE_M + 0.5 * DEEPEST_M * (1.0 - math.cos(math.pi * (at_s - STEP_S * STEPS)))


def loopback() -> tuple[int, int]:
    """Return bytes and packets that the loopback has sent."""
    line = next(each for each in Path("/proc/net/dev").read_text().splitlines() if each.lstrip().startswith("lo:"))
    fields = line.split(":")[1].split()
    return int(fields[0]), int(fields[1])


def leader(way: str) -> None:
    """Be a leader, over plain topics or behind hapticnet; print what was felt as JSON."""
    places = writer("R/servo_cp" if way == "plain" else "L/measured_cp", PoseStamped)
    forces = reader("R/measured_cf" if way == "plain" else "L/servo_cf", WrenchStamped)
    rows: list[tuple[float, float, float]] = []
    felt_n, began_s = 0.0, time.monotonic() + WARM_S
    before = loopback()
    due_s = time.monotonic()
    while (at_s := time.monotonic() - began_s) < STEP_S * STEPS + PRESS_S:
        if at_s < 0.0:
            before = loopback()
        z_m = wanted_m(at_s)
        places.write(made(PoseStamped, (0.0, 0.0, z_m, 0.0, 0.0, 0.0, 1.0), "base"))
        for force in forces.take(1):
            if force.sample_info.valid_data:
                felt_n = -force.wrench.force.z
        rows.append((at_s, z_m, felt_n))
        due_s += 0.001
        time.sleep(max(due_s - time.monotonic(), 0.0))
    sent, packets = (after - earlier for after, earlier in zip(loopback(), before, strict=True))
    print(json.dumps({"rows": rows, "bytes": sent - ETHERNET * packets}))


def start(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    """Start this program or hapticnet."""
    return subprocess.Popen([sys.executable, *arguments], text=True, **options)  # noqa: S603 - our own programs


def account(name: str, options: list[str] | None, folder: Path, said: IO[str]) -> str:
    """Run one way, and return its row of the table."""
    report = folder / "report.json"
    own = str(Path(__file__).resolve())
    beside = [start(own, "robot")]
    if options is not None:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": said}
        scene = "hapticnet_ros2:Robot:namespace=/R,axes=z,domain=0,interface=lo"
        hand = "hapticnet_ros2:Leader:namespace=/L,axes=z,max_force_n=5,domain=0,interface=lo"
        beside.append(start("-m", "hapticnet", "slave", "--listen", ADDRESS, "--scene", scene, **quiet))
        asked = ["--connect", ADDRESS, "--operator", hand, "--device", "none", "--report", str(report), *options]
        beside.append(start("-m", "hapticnet", "master", *asked, **quiet))
    hand_process = start(own, "leader", "plain" if options is None else "behind", stdout=subprocess.PIPE)
    found = json.loads(hand_process.communicate()[0])
    for each in reversed(beside):
        each.terminate()
        each.wait()
    at_s, z_m, felt_n = np.array(found["rows"]).T
    took_ms = []
    for step in range(3, STEPS):
        since = at_s > step * STEP_S
        half_n = STIFFNESS * (BASE_M + 0.5 * STEP_M)
        come = np.flatnonzero(since & (felt_n > half_n if step % 2 else felt_n < half_n))
        took_ms.append(1e3 * (at_s[come[0]] - at_s[np.flatnonzero(since)[0]]) if come.size else math.nan)
    pressed = at_s > STEP_S * STEPS
    error_n = felt_n[pressed] - STIFFNESS * z_m[pressed]
    bytes_s = found["bytes"] / (STEP_S * STEPS + PRESS_S)
    if options is not None:
        ended = json.loads(report.read_text())
        sent = sum(ended[way]["wire_bytes"] for way in ("sent", "received"))
        bytes_s = 1e3 * sent / ended["ticks"]
    return (
        f"| {name} | {statistics.median(took_ms):.1f} | {np.nanquantile(took_ms, 0.95):.1f}"
        f" | {1e-3 * bytes_s:.1f} | {math.sqrt(np.mean(error_n**2)):.3f} |"
    )


def main() -> None:
    """Print the table."""
    if os.environ.get("HAPTICNET_ROS2_NETWORK") is None:
        line = 'ip link set lo up && ip link set lo multicast on && exec "$@"'
        environment = os.environ | {"HAPTICNET_ROS2_NETWORK": "own"}
        command = ["unshare", "--net", "sh", "-c", line, "-", sys.executable, __file__]
        raise SystemExit(subprocess.run(command, env=environment, check=False).returncode)  # noqa: S603 - our own
    # As robots and devices are; their processes and the threads of DDS inherit it
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    print("| | force back after, median ms | 95 % | kB/s, both ways | error, RMSE N |\n| --- | --: | --: | --: | --: |")
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as said:
        for name, options in WAYS.items():
            print(account(name, options, Path(folder), said), flush=True)
        said.seek(0)
        late = [line for line in said if "for 20 ms" in line]
    print(f"\n{len(late)} times the newest message was too old; up to two at the end of each run, when the leader ends")


if __name__ == "__main__":
    roles = {"robot": robot, "leader": lambda: leader(sys.argv[2])}
    role: Callable[[], None] = roles.get(sys.argv[1] if len(sys.argv) > 1 else "", main)
    role()
