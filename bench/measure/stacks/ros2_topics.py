"""Topics of ROS 2 over Cyclone DDS: PoseStamped one way, WrenchStamped the other; best effort, one message kept.

Each message is answered in the thread of DDS that brings it. The stamp of the header is the position's, in both.
Each participant is given the other's address, because the emulated link carries no multicast.
"""

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cyclonedds.core import Listener, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from peer_link import FAR_HOST, INTERFACE, NEAR_HOST

from stacks import MESSAGE, Answer, Deliver, Ready, Send

sys.path.append(str(Path(__file__).parents[3] / "extras" / "ros2"))
from hapticnet_ros2.messages import Header, Point, Pose, PoseStamped, Time, Vector3, Wrench, WrenchStamped

QOS = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1), Policy.Durability.Volatile)
SETTINGS = f"""<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="{INTERFACE}"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>3</MaxAutoParticipantIndex>
<Peers><Peer Address="{NEAR_HOST}"/><Peer Address="{FAR_HOST}"/></Peers></Discovery>
</Domain></CycloneDDS>"""


KEPT: list[object] = []
"""What must stay alive while messages come."""


class Heard(Listener):
    """Calls a function with each message."""

    def __init__(self, take: Callable[[Any], None]) -> None:
        super().__init__()
        self._take = take

    def on_data_available(self, reader: "DataReader[Any]") -> None:
        for message in reader.take(1):
            if message.sample_info.valid_data:
                self._take(message)


def join(out: tuple[str, type], back: tuple[str, type], take: Callable[[Any], None]) -> tuple[Any, Any]:
    """Return the writer of one topic and the reader of another."""
    domain = Domain(0, SETTINGS)
    member = DomainParticipant(0)
    writer = DataWriter(member, Topic(member, f"rt/{out[0]}", out[1], qos=QOS), qos=QOS)
    reader = DataReader(member, Topic(member, f"rt/{back[0]}", back[1], qos=QOS), qos=QOS, listener=Heard(take))
    KEPT.extend([domain, reader])
    return writer, reader


def header(t_us: int) -> Header:
    seconds, us = divmod(t_us, 1_000_000)
    return Header(Time(seconds, 1000 * us))


def stamp_us(message: Any) -> int:
    return 1_000_000 * message.header.stamp.sec + message.header.stamp.nanosec // 1000


POSITIONS, FORCES = ("servo_cp", PoseStamped), ("measured_cf", WrenchStamped)


async def serve(_: str, answer: Answer, ready: Ready) -> None:
    def take(message: PoseStamped) -> None:
        t_us, force_n = MESSAGE.unpack(answer(MESSAGE.pack(stamp_us(message), message.pose.position.z)))
        writer.write(WrenchStamped(header(t_us), Wrench(Vector3(z=force_n))))

    writer, _reader = join(FORCES, POSITIONS, take)
    ready()
    await asyncio.Event().wait()


async def connect(_: str, deliver: Deliver) -> Send:
    writer, reader = join(
        POSITIONS, FORCES, lambda message: deliver(MESSAGE.pack(stamp_us(message), message.wrench.force.z))
    )
    while not (
        writer.get_publication_matched_status().current_count and reader.get_subscription_matched_status().current_count
    ):
        await asyncio.sleep(0.02)

    def send(data: bytes) -> None:
        t_us, position_m = MESSAGE.unpack(data)
        writer.write(PoseStamped(header(t_us), Pose(Point(z=position_m))))

    return send
