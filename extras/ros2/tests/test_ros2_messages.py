import struct
from types import SimpleNamespace

import pytest
from dds_peers import HERE, wrench

from hapticnet_ros2.messages import (
    Header,
    JointState,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Time,
    Vector3,
    Wrench,
    WrenchStamped,
)
from hapticnet_ros2.topics import Input, participant


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


def test_a_joint_has_the_bytes_of_the_specification():
    by_hand = bytes.fromhex(
        "00010000 01000000 02000000"  # encapsulation and stamp
        "05000000 61626364 00000000"  # frame, and padding to 4
        "01000000 04000000 6a617700"  # one name
        "01000000 00000000 000000000000e03f"  # one position, aligned to 8: 36 bytes so far
        "00000000"  # no velocity
        "01000000 0000000000000040"  # one effort
    )
    message = JointState(Header(Time(1, 2), "abcd"), ["jaw"], [0.5], [], [2.0])
    assert message.serialize(use_version_2=False) == by_hand
    assert JointState.deserialize(by_hand) == message


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
