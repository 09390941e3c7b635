import itertools
import math
import os
import re
import shutil
import signal
import statistics
import struct
import subprocess
import threading
import time
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

import hapticnet as hn
from hapticnet.errors import SettingsError
from hapticnet_ros2 import Leader, Robot
from hapticnet_ros2.messages import (
    Header,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Time,
    TransformStamped,
    Vector3,
    Wrench,
    WrenchStamped,
)
from hapticnet_ros2.topics import BEST_EFFORT, RELIABLE, TOPIC, Input, participant

DOMAIN = 88
HERE = {"domain": DOMAIN, "interface": "lo"}
CALM = HERE | {"fresh_ms": 200.0}  # processes of a busy machine stand still for longer than 20 ms
POSE, WRENCH = (f"geometry_msgs::msg::dds_::{each}Stamped_" for each in ("Pose", "Wrench"))
numbers = itertools.count(1)


@pytest.fixture
def space():
    return f"/T{os.getpid()}_{next(numbers)}"  # other processes test beside this one


def pose(x=0.0, y=0.0, z=0.0, stamp=None):
    return PoseStamped(Header(stamp or now()), Pose(Point(x, y, z), Quaternion()))


def wrench(x=0.0, y=0.0, z=0.0, stamp=None):
    return WrenchStamped(Header(stamp or now()), Wrench(Vector3(x, y, z)))


def now():
    return Time(*divmod(time.time_ns(), 1_000_000_000))


@cache
def there():
    participant(**HERE)  # which chooses the interface of this process
    return DomainParticipant(DOMAIN)


def writer(topic, kind, qos=BEST_EFFORT):
    return DataWriter(there(), Topic(there(), f"rt{topic}", kind, qos=TOPIC), qos=qos)


def reader(topic, kind, qos=BEST_EFFORT):
    return DataReader(there(), Topic(there(), f"rt{topic}", kind, qos=TOPIC), qos=qos)


class Behind:
    """A robot behind DDS that moves at once, in front of a spring, or a hand: whatever `answer` makes of messages."""

    def __init__(self, answer, outputs, heard=None, period_s=0.001):
        self.outputs, self.heard, self.answer, self.newest = outputs, heard, answer, None
        self.is_talking, self._ends, self._period_s = True, False, period_s
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._ends:
            if self.heard is not None:
                found = self.heard.take(1)
                self.newest = found[0] if found and found[0].sample_info.valid_data else self.newest
            if self.is_talking:
                for output, message in zip(self.outputs, self.answer(self.newest), strict=True):
                    if message is not None:
                        output.write(message)
            time.sleep(self._period_s)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ends = True
        self._thread.join()


def robot_behind(space, answer=None, kind=PoseStamped, qos=BEST_EFFORT):
    """A robot that is at 0.1 m on each axis first, and feels 400 N/m against what moves it away."""

    def spring(newest):
        at = newest.pose.position if newest else Point(0.1, 0.1, 0.1)
        felt_n = (-400.0 * (each - 0.1) for each in (at.x, at.y, at.z))
        return pose(at.x, at.y, at.z), wrench(*felt_n)

    outputs = [writer(f"{space}/measured_cp", kind, qos), writer(f"{space}/measured_cf", WrenchStamped, qos)]
    return Behind(answer or spring, outputs, reader(f"{space}/servo_cp", kind, qos))


def step(robot, *position_m):
    return robot.step(hn.PositionSample(0, position_m))


def settle(robot, *position_m, seconds=0.2):
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        force_n = step(robot, *position_m)
        time.sleep(0.001)
    return force_n


@pytest.fixture
def made():
    objects = []
    yield lambda found: objects.append(found) or found
    for each in objects:
        each.close()


def test_a_pose_has_the_bytes_of_the_specification():
    message = PoseStamped(Header(Time(1, 2), "psm"), Pose(Point(1.0, 2.0, -0.5), Quaternion(0.0, 0.0, 0.0, 1.0)))
    # OMG DDSI-RTPS 10.2 and CORBA CDR 15.3: CDR_LE, then each value aligned to its size from the end of those 4 bytes
    by_hand = bytes.fromhex(
        "00010000"  # encapsulation
        "01000000 02000000"  # stamp
        "04000000 70736d00"  # length with the final zero, and text: 16 bytes so far, so that the doubles follow
        "000000000000f03f 0000000000000040 000000000000e0bf"
        "0000000000000000 0000000000000000 0000000000000000 000000000000f03f"
    )
    assert message.serialize(use_version_2=False) == by_hand
    assert PoseStamped.deserialize(by_hand) == message


def test_a_wrench_aligns_its_doubles_after_a_frame_of_any_length():
    for frame in ("", "a", "abc", "world", "PSM1_base"):
        text = frame.encode() + b"\0"
        head = struct.pack("<iII", 7, 8, len(text)) + text
        head += bytes(-len(head) % 8)
        by_hand = b"\0\1\0\0" + head + struct.pack("<6d", 1, 2, 3, 4, 5, 6)
        message = WrenchStamped(Header(Time(7, 8), frame), Wrench(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0)))
        assert message.serialize(use_version_2=False) == by_hand
        big = struct.pack(">iII", 7, 8, len(text)) + text
        big += bytes(-len(big) % 8)
        assert WrenchStamped.deserialize(b"\0\0\0\0" + big + struct.pack(">6d", 1, 2, 3, 4, 5, 6)) == message


def test_topics_have_the_names_that_ros_gives_them(space, made):
    robot = made(Robot(space, **CALM))
    assert robot._sent._writer.topic.name == f"rt{space}/servo_cp"
    assert robot._sent._writer.topic.typename == "geometry_msgs::msg::dds_::PoseStamped_"
    assert robot._force._topic.typename == "geometry_msgs::msg::dds_::WrenchStamped_"


def test_a_robot_starts_where_it_is_and_moves_along_the_axes_named(space, made):
    with robot_behind(space) as behind:
        robot = made(Robot(space, "-zx", scale=2.0, orientation="0/0.6/0/0.8", **CALM))
        settle(robot, 0.5, 0.5)
        assert behind.newest.pose.position == Point(0.1, 0.1, 0.1)
        force_n = settle(robot, 0.505, 0.49)
        at = behind.newest.pose
        assert (at.position.x, at.position.y, at.position.z) == pytest.approx((0.08, 0.1, 0.09))
        assert at.orientation == Quaternion(0.0, 0.6, 0.0, 0.8)  # unchanged
        assert force_n == pytest.approx((4.0, -8.0))  # a spring: positive where the coordinate is


def test_without_options_the_orientation_is_the_robots_own(space, made):
    turn = Quaternion(0.0, 0.0, 1.0, 0.0)
    with robot_behind(space, lambda _: (PoseStamped(Header(now()), Pose(Point(), turn)), wrench())) as behind:
        settle(made(Robot(space, 3, **CALM)), 0.0, 0.0, 0.0)
        assert behind.newest.pose.orientation == turn


def test_positions_can_be_transforms_as_in_older_robots(space, made):
    qos = BEST_EFFORT
    with Behind(lambda _: (), [], reader(f"{space}/servo_cp", TransformStamped, qos)) as behind:
        place = {"home": "1/2/3", "orientation": "0/0/0/1"}
        settle(made(Robot(space, "y", message="TransformStamped", **place, **CALM)), 0.0)
        assert behind.newest.transform.translation == Vector3(1.0, 2.0, 3.0)
        assert behind.newest.child_frame_id == ""


def test_a_leap_of_the_hand_is_made_at_the_largest_speed(space, made):
    with robot_behind(space) as behind:
        robot = made(Robot(space, "z", speed=0.1, **CALM))
        settle(robot, 0.0)
        settle(robot, 1.0, seconds=0.2)
        assert 0.1 < behind.newest.pose.position.z < 0.1 + 0.1 * 0.3


def test_subscribers_that_ask_for_reliability_hear_it_too(space, made):
    with robot_behind(space, qos=RELIABLE) as behind:
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (0.0,)
        assert settle(robot, 0.01) == pytest.approx((4.0,))
        assert behind.newest is not None
        assert robot._sent.dropped == 0


def test_a_robot_that_stops_is_one_line_and_no_force(space, made, caplog):
    with robot_behind(space) as behind:
        robot = made(Robot(space, "z", **CALM))
        settle(robot, 0.0)
        assert settle(robot, 0.01) == pytest.approx((4.0,))
        behind.is_talking = False
        stopped_s = time.monotonic()
        forces_n = []
        while time.monotonic() < stopped_s + 0.6:
            forces_n.append((time.monotonic() - stopped_s, step(robot, 0.01)[0]))
            time.sleep(0.001)
        assert all(force_n == 0.0 for at_s, force_n in forces_n if at_s > 0.45)
        assert all(after <= before for (_, before), (_, after) in itertools.pairwise(forces_n))
        assert [line for line in caplog.messages if "measured_cf" in line] == [
            f"no WrenchStamped on {space}/measured_cf for 200 ms; the force is zero"
        ]
        behind.is_talking = True
        assert settle(robot, 0.01) == pytest.approx((4.0,))
        assert f"WrenchStamped on {space}/measured_cf arrives again" in caplog.messages


def test_a_message_that_is_repeated_is_not_new(space, made, caplog):
    stamps = [None]
    with robot_behind(space, lambda _: (pose(), wrench(z=-4.0, stamp=stamps[0]))):
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (4.0,)
        stamps[0] = now()
        assert settle(robot, 0.0, seconds=0.6) == (0.0,)
        assert f"no WrenchStamped on {space}/measured_cf for 200 ms; the force is zero" in caplog.messages


def test_the_age_of_a_message_counts_from_its_arrival_even_if_positions_come_rarely(space, made):
    with robot_behind(space, lambda _: (pose(), wrench(z=-4.0))) as behind:
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (4.0,)
        for _ in range(3):
            time.sleep(0.5)
            assert step(robot, 0.0) == (4.0,)  # as fresh as if asked all the time
        time.sleep(0.05)
        behind.is_talking = False
        time.sleep(0.6)
        assert step(robot, 0.0) == (0.0,)  # what waits there is 0.6 s old


class Sent:
    """A reader of DDS with messages that were sent at times of a clock that is 1000 s behind."""

    def __init__(self):
        self.waiting = []

    def send(self, at_s, force_n=1.0):
        message = wrench(z=force_n, stamp=Time(0, 0))
        message.sample_info = SimpleNamespace(source_timestamp=round(1e9 * (at_s - 1000.0)))
        self.waiting = [message]

    def take(self, _):
        found, self.waiting = self.waiting, []
        return found


@pytest.fixture
def heard(space):
    heard = Input(participant(**HERE), f"{space}/measured_cf", WrenchStamped, 20.0)
    heard._reader = Sent()
    return heard


def test_a_message_decays_from_20_to_40_ms_after_it_was_sent(heard):
    for at_s in (5000.0, 5000.001):
        heard._reader.send(at_s)
        heard.poll(at_s)
    shares = [heard.share(5000.001 + age_s) for age_s in (0.0, 0.019, 0.03, 0.0401)]
    assert shares == pytest.approx([1.0, 1.0, 0.5, 0.0])
    assert heard.usable(5000.04)
    assert not heard.usable(5000.042)


def test_a_first_message_is_of_unknown_age_and_so_is_one_after_a_long_pause(heard):
    heard._reader.send(5000.0)
    heard.poll(5000.0)
    assert heard.share(5000.0) == 0.0
    heard._reader.send(5000.001)
    heard.poll(5000.001)
    assert heard.share(5000.001) == 1.0
    heard._reader.send(5060.0)
    heard.poll(5060.0)
    assert heard.share(5060.0) == 0.0


@pytest.mark.parametrize("gap_s", [0.05, 0.4, 1.9])
def test_what_waited_is_as_old_as_it_is(heard, gap_s):
    for at_s in (5000.0, 5000.001):
        heard._reader.send(at_s)
        heard.poll(at_s)
    heard._reader.send(5000.001 + gap_s)
    heard.poll(5000.001 + gap_s + 0.03)
    assert heard.share(5000.001 + gap_s + 0.03) == pytest.approx(0.5, abs=0.1)


def test_clocks_that_drift_or_are_set_are_no_fault_for_long(heard):
    for tick in range(20_000):  # a clock that is slow by a tenth of the allowed
        at_s = 5000.0 + 0.001 * tick
        heard._reader.send(5000.0 + 0.001 * tick * (1.0 - 1e-4))
        heard.poll(at_s)
    assert heard.share(at_s) == 1.0
    for tick in range(1, 4):  # a clock that is set back
        at_s += 0.001
        heard._reader.send(4000.0 + 0.001 * tick)
        heard.poll(at_s)
    assert heard.share(at_s) == 1.0


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e9])
def test_a_force_that_is_none_is_one_line_and_no_force(space, made, caplog, wrong):
    felt_n = [-4.0]
    with robot_behind(space, lambda _: (pose(), wrench(z=felt_n[0]))):
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (4.0,)
        felt_n[0] = wrong
        assert settle(robot, 0.0, seconds=0.1) == (0.0,)
        assert [line for line in caplog.messages if "measured_cf" in line] == [
            f"WrenchStamped on {space}/measured_cf has a value that is NaN or too large; the force is zero"
        ]
        felt_n[0] = -2.0
        assert settle(robot, 0.0) == (2.0,)


def test_it_is_said_who_is_missing_or_of_another_kind(space, made, caplog):
    with Behind(lambda _: (pose(),), [writer(f"{space}/measured_cf", PoseStamped)]):
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.01, seconds=1.3) == (0.0,)
    assert sorted(each for each in caplog.messages if space in each) == [
        f"PoseStamped on {space}/servo_cp is not heard: nobody subscribes",
        f"no PoseStamped on {space}/measured_cp: nobody publishes it; the force is zero",
        f"no WrenchStamped on {space}/measured_cf: it carries {POSE}, not {WRENCH}; the force is zero",
    ]


def test_a_subscriber_that_cannot_hear_best_effort_is_said(space, made, caplog):
    with robot_behind(space, qos=RELIABLE) as behind:
        settle(made(Robot(space, "z", reliable=False, **CALM)), 0.0, seconds=1.2)
        assert behind.newest is None
    assert any("servo_cp is not heard: its subscriber asks for reliable messages" in each for each in caplog.messages)


def test_the_newest_master_moves_the_robot_and_the_other_feels_nothing(space, made, caplog):
    with robot_behind(space, lambda _: (pose(), wrench(z=-4.0))):
        first, second = (made(Robot(space, "z", **CALM)) for _ in range(2))
        first.welcome("a")
        assert settle(first, 0.0) == (4.0,)
        assert settle(second, 0.0, seconds=0.05) == (0.0,)
        second.welcome("b")
        assert settle(first, 0.0, seconds=0.05) == (0.0,)
        assert settle(second, 0.0) == (4.0,)
    assert f"ros2:{space} is moved by another master; the force is zero" in caplog.messages


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"axes": 4}, "axes is '4'; it must be 1, 2, 3, or"),
        ({"axes": "xx"}, "axes is 'xx'"),
        ({"namespace": "/PSM 1"}, "cannot be the name of a topic"),
        ({"domain": 300}, "domain is 300"),
        ({"interface": "eth99"}, "already uses interface 'lo'"),
        ({"domain": 89, "interface": "eth99"}, "DDS cannot be used in domain 89 on interface 'eth99'"),
        ({"message": "Pose"}, "must be PoseStamped or TransformStamped"),
        ({"scale": 0.0}, "scale is 0.0"),
        ({"fresh_ms": 0.0}, "fresh_ms is 0.0"),
    ],
)
@pytest.mark.parametrize("made_of", [Robot, Leader])
def test_what_cannot_be_used_is_said_in_one_sentence(made_of, given, said):
    with pytest.raises(SettingsError, match=said) as refused:
        made_of(**HERE | given)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("given", [{"home": "1/2"}, {"home": "1/2/nan"}, {"orientation": "1/1/1/1"}, {"speed": 0.0}])
def test_options_of_a_robot_are_checked(given):
    with pytest.raises(SettingsError):
        Robot(**HERE | given)


def test_ros_domain_id_is_the_default(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "here")
    with pytest.raises(SettingsError, match="ROS_DOMAIN_ID is 'here'"):
        Leader()


def leader_behind(space, answer):
    """A device whose `newest` is the force that it was told."""
    outputs = [writer(f"{space}/measured_cp", PoseStamped)]
    return Behind(answer, outputs, reader(f"{space}/servo_cf", WrenchStamped, RELIABLE))


def hold(leader, force_n, seconds):
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        leader.feel(0, force_n)
        sample = leader.sample(0)
        time.sleep(0.001)
    return sample.position_m


def test_a_leader_moves_the_tool_and_gets_the_force_against_its_axis(space, made):
    at = [0.3, 0.2, 0.1]
    with leader_behind(space, lambda _: (pose(*at),)) as behind:
        leader = made(Leader(space, "-zx", scale=2.0, max_force_n=3.0, **CALM))
        assert hold(leader, (0.0, 0.0), 0.2) == (0.0, 0.0)
        at[:] = 0.301, 0.2, 0.095
        assert hold(leader, (1.0, -2.0), 0.7) == pytest.approx((0.01, 0.002))
        assert behind.newest.wrench.force == Vector3(2.0, 0.0, 1.0)
        hold(leader, (3.0, 4.0), 0.1)
        force = behind.newest.wrench.force
        assert (force.x, force.z) == pytest.approx((-2.4, 1.8))  # 3 N in the same direction
        leader.close()
        time.sleep(0.05)
        assert behind.newest.wrench.force == Vector3()


def test_the_force_at_a_leader_rises_from_zero(space, made):
    with leader_behind(space, lambda _: (pose(),)) as behind:
        leader = made(Leader(space, "z", max_force_n=2.0, **CALM))
        while not leader._measured.usable(time.monotonic()):
            hold(leader, (2.0,), 0.001)
        hold(leader, (2.0,), 0.1)
        time.sleep(0.01)
        assert 0.0 < -behind.newest.wrench.force.z < 1.0


@pytest.mark.parametrize("fault", ["silent", "nan"])
def test_a_leader_that_stops_gets_no_force_and_does_not_jump(space, made, caplog, fault):
    at = [0.0]
    with leader_behind(space, lambda _: (pose(z=at[0]),)) as behind:
        leader = made(Leader(space, "z", **CALM))
        hold(leader, (1.0,), 0.2)
        at[0] = 0.01
        assert hold(leader, (1.0,), 0.5) == pytest.approx((0.01,))
        assert behind.newest.wrench.force.z == pytest.approx(-1.0)
        if fault == "nan":
            at[0] = math.nan
        else:
            behind.is_talking = False
        assert hold(leader, (1.0,), 0.6) == pytest.approx((0.01,))
        assert behind.newest.wrench.force == Vector3()
        assert len([each for each in caplog.messages if "measured_cp" in each]) == 1
        at[0], behind.is_talking = 0.5, True
        assert hold(leader, (1.0,), 0.1) == pytest.approx((0.01,))


def test_from_leader_to_robot_over_udp_and_back(space, made):
    hand_m = [0.0]
    with (
        robot_behind(f"{space}/PSM1") as robot,
        leader_behind(f"{space}/MTML", lambda _: (pose(z=-hand_m[0]),)) as device,
        hn.ThreadedSlave(Robot(f"{space}/PSM1", "-zxy", **CALM), listen="127.0.0.1:0") as slave,
    ):
        leader = made(Leader(f"{space}/MTML", "-zxy", **CALM))
        with hn.ThreadedMaster(slave.address, operator=leader, codec="deadband") as master:
            time.sleep(0.6)
            for _ in range(400):  # 4 mm in 0.4 s
                hand_m[0] += 1e-5
                time.sleep(0.001)
            time.sleep(0.6)
            assert robot.newest.pose.position.z == pytest.approx(0.1 - 0.004, abs=1e-5)
            assert master.force_n[0] == pytest.approx(1.6, rel=0.05)
            assert device.newest.wrench.force.z == pytest.approx(1.6, rel=0.05)  # out, which is along z
            assert device.newest.wrench.force.x == device.newest.wrench.force.y == 0.0
            robot.is_talking = False
            time.sleep(0.7)
            assert master.force_n[0] < 0.025  # the floor of the deadband: zero is felt as no other force
            assert device.newest.wrench.force.z < 0.025


def test_the_robot_of_the_page_runs(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<General><Interfaces><NetworkInterface name='lo'/></Interfaces></General>")
    (example,) = re.findall(r"```python\n(.*?)```", (Path(__file__).parents[1] / "README.md").read_text(), re.DOTALL)
    assert "while True:" in example
    exec(compile(example.replace("while True:", "for _ in range(10):"), "README.md", "exec"), {})  # noqa: S102 - our own


@pytest.fixture(scope="module")
def fast_robot(tmp_path_factory):
    source, program = Path(__file__).with_name("fast_robot.cpp"), tmp_path_factory.mktemp("fast") / "fast_robot"
    if not Path("/usr/include/fastdds").exists() or not shutil.which("g++"):
        pytest.skip("needs g++ and libfastrtps-dev")
    subprocess.run(["g++", "-std=c++17", source, "-o", program, "-lfastrtps", "-lfastcdr"], check=True)
    return program


@pytest.mark.parametrize("quality", ["reliable", "best"])
def test_another_implementation_of_dds_reads_and_writes_the_same(fast_robot, space, made, quality):
    command = [fast_robot, str(DOMAIN), space, quality]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        robot = made(Robot(space, "-z", **CALM))
        until_s = time.monotonic() + 5.0
        while not robot._force.newest.values and time.monotonic() < until_s:  # until they have found each other
            settle(robot, 0.0)
        assert settle(robot, 0.005, seconds=1.0) == pytest.approx((2.0,))
        process.send_signal(signal.SIGSTOP)  # a subscriber that hangs holds nobody up
        took_s = []
        for _ in range(600):
            began_s = time.monotonic()
            force_n = step(robot, 0.005)
            took_s.append(time.monotonic() - began_s)
            time.sleep(0.001)
        assert force_n == (0.0,)
        assert statistics.quantiles(took_s, n=20)[-1] < 0.01
        process.send_signal(signal.SIGCONT)
        received, x_m, z_m, w = process.communicate()[0].split()
    assert int(received) > 500
    assert (float(x_m), float(z_m), float(w)) == (0.0, 0.095, 1.0)
