"""Topics of DDS: the newest message of each and its age, and messages sent, without waiting.

There is no thread: it would hold the GIL when a tick needs it, and have a lower priority.
"""

import contextlib
import logging
import math
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeAlias
from xml.sax.saxutils import quoteattr

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from hapticnet.checks import check_integer, check_parameter
from hapticnet.errors import SettingsError
from hapticnet_ros2.messages import POSITIONS, PREFIX, Message, PoseStamped, TransformStamped, made
from hapticnet_ros2.settings import domain_from, topic_from

LOG: Final = logging.getLogger("hapticnet.ros2")

FORGET_S: Final = 2.0  # after a longer pause, the age of a message cannot be told from the one before
DRIFT: Final = 1e-3  # largest difference in rate of two clocks, and how fast a delay is forgotten
PATIENCE_S: Final = 1.0  # time that DDS gets to find the other side, before a line says that it is missing
LINES_EVERY_S: Final = 10.0  # shortest time between two equal lines
SHORTEST: Final = 1e-3  # length of a quaternion below which it is none
LARGEST: Final = 1e4  # of any value, in SI units: above what any arm reaches or bears
FRESH_MS: Final = 20.0

# Each force or position is replaced within milliseconds, so only the newest message is kept, and readers that join late
# get none. A reader that asks for best effort hears all writers. All readers hear a writer that offers reliability, and
# those of CRTK and of ROS's defaults do ask for it; with one message kept it never waits.
COMMON: Final = (
    Policy.History.KeepLast(1),
    Policy.Durability.Volatile,
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
BEST_EFFORT: Final = Qos(Policy.Reliability.BestEffort, *COMMON)
TOPIC: Final = Qos(*COMMON)
RELIABLE: Final = Qos(Policy.Reliability.Reliable(max_blocking_time=0), *COMMON)

_participants: dict[int, tuple[str, DomainParticipant, Domain | None]] = {}


def participant(domain: float | None, interface: str) -> DomainParticipant:
    """Return the participant of this process in a domain, on a network interface ("": as CYCLONEDDS_URI says).

    SettingsError if DDS cannot be used there, or this process already uses the domain on another interface.
    """
    domain = domain_from(domain)
    check_integer("domain", domain, 0, 232)
    number = int(domain)
    if number not in _participants:
        name = quoteattr(str(interface))
        interfaces = f"<General><Interfaces><NetworkInterface name={name}/></Interfaces></General>"
        settings = f"<CycloneDDS><Domain>{interfaces}</Domain></CycloneDDS>"
        try:
            configured = Domain(number, settings) if interface else None
            _participants[number] = str(interface), DomainParticipant(number), configured
        except DDSException as error:
            where = f" on interface {interface!r}" if interface else ""
            raise SettingsError(f"DDS cannot be used in domain {number}{where}: {error.msg}") from None
    used, found, _ = _participants[number]
    if interface not in ("", used):
        raise SettingsError(f"domain {number} already uses interface {used!r} in this process, not {interface!r}")
    return found


class Dds:
    """The topics of a namespace, with the options `hapticnet_ros2.settings.DdsOptions`; SettingsError if invalid."""

    def __init__(
        self,
        namespace: str,
        message: str = "PoseStamped",
        frame_id: str = "",
        domain: int | None = None,
        interface: str = "",
        reliable: bool = True,
        fresh_ms: float = FRESH_MS,
    ) -> None:
        if message not in POSITIONS:
            raise SettingsError(f"message is {message!r}; it must be {' or '.join(POSITIONS)}")
        self.position_kind: type[PoseStamped] | type[TransformStamped] = POSITIONS[message]
        self._member = participant(domain, interface)
        self._namespace, self._frame_id, self._fresh_ms = namespace, frame_id, fresh_ms
        self._reliable = reliable is True

    def name_of(self, topic: str) -> str:
        """Return the full name of a topic."""
        return topic_from(self._namespace, topic)

    def input(self, topic: str, kind: type[Message], fault_of: "FaultOf | None" = None) -> "Input":
        """Return the newest message of a topic; `fault_of` says what is wrong with its values."""
        return Input(self._member, self.name_of(topic), kind, self._fresh_ms, fault_of or fault_of_numbers)

    def output(self, topic: str, kind: type[Message]) -> "Output":
        """Return what sends messages to a topic."""
        return Output(self._member, self.name_of(topic), kind, self._frame_id, reliable=self._reliable)


FaultOf: TypeAlias = Callable[[tuple[float, ...]], str]
"""Returns what is wrong with the values of a message; empty if nothing is."""


def fault_of_numbers(values: tuple[float, ...]) -> str:
    """Return what is wrong with numbers of which each counts."""
    # Written so that NaN, which compares false with everything, is refused too.
    is_fine = all(-LARGEST <= each <= LARGEST for each in values)
    return "" if is_fine else "has a value that is NaN or too large"


def fault_of_pose(values: tuple[float, ...]) -> str:
    """Return what is wrong with a position and an orientation."""
    has_turn = math.hypot(*values[3:]) > SHORTEST
    return fault_of_numbers(values) or ("" if has_turn else "has no orientation: its quaternion is zero")


def fault_of_position(values: tuple[float, ...]) -> str:
    """Return what is wrong with a joint whose position counts."""
    return fault_of_numbers(values[:1]) and "must have one position, a number"


def fault_of_joint(values: tuple[float, ...]) -> str:
    """Return what is wrong with a joint whose position and effort count."""
    return fault_of_numbers(values) and "must have one position and one effort, both numbers"


class Newest(NamedTuple):
    """Values of the newest message, and when it was sent, by our clock; -inf if there is none."""

    values: tuple[float, ...]
    at_s: float


class Input:
    """The newest valid message of a topic."""

    def __init__(
        self,
        member: DomainParticipant,
        topic: str,
        kind: type[Message],
        fresh_ms: float,
        fault_of: FaultOf = fault_of_numbers,
    ) -> None:
        check_parameter("fresh_ms", fresh_ms, 1.0, 1000.0, "ms")
        self.what = f"{kind.__name__} on {topic}"
        self.newest = Newest((), -math.inf)
        self.fresh_s = 1e-3 * fresh_ms
        self.fault: str | None = None
        self._fault_of = fault_of
        self._topic, self._member = Topic(member, PREFIX + topic, kind, qos=TOPIC), member
        self._reader: Any = DataReader(member, self._topic, qos=BEST_EFFORT)
        self._stamp = (0, 0)
        self._before: tuple[float, float] | None = None  # of the message before: sent by its own clock, and by ours
        self._began_s: float | None = None
        self._told_s: dict[str, float] = {}

    def share(self, now_s: float) -> float:
        """Return the share of a force that may still be felt: 1 up to the age `fresh_s`, falling to 0 at twice it."""
        return min(max(2.0 - (now_s - self.newest.at_s) / self.fresh_s, 0.0), 1.0)

    def usable(self, now_s: float) -> tuple[float, ...]:
        """Return the values of the newest message; empty if it is so old that `share` is 0."""
        values, at_s = self.newest
        return values if now_s - at_s < 2.0 * self.fresh_s else ()

    def poll(self, now_s: float) -> None:
        """Take the newest message, if one has come, and log once what is wrong."""
        try:
            for message in self._reader.take(1):
                if isinstance(message, self._topic.data_type):
                    self._receive(message, now_s)
        except Exception as error:  # the payload is no such message
            self._refuse(f"cannot be read: {error}")
        self._watch(now_s)

    def _receive(self, message: Any, now_s: float) -> None:
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        if stamp == self._stamp != (0, 0):
            return  # a node repeats the last message of a robot that has stopped
        self._stamp = stamp
        values = message.values()
        if wrong := self._fault_of(values):
            self._refuse(wrong)
            return
        # A message may have waited here since the last poll, so its arrival does not tell its age. The difference
        # of the sender's stamps tells how much younger it is than the message before; the clocks need not agree. The
        # age of a first message is unknown.
        sent_s = 1e-9 * message.sample_info.source_timestamp
        before, self._before = self._before, (sent_s, now_s)
        if before is None or sent_s < before[0] or now_s - before[1] > FORGET_S:
            return
        at_s = min(before[1] + (1.0 + DRIFT) * (sent_s - before[0]), now_s)
        self._before = sent_s, at_s
        self.newest = Newest(values, at_s)
        if self.fault is not None and self.share(now_s) == 1.0:
            self.fault = None
            self._tell(f"{self.what} arrives again")

    def _refuse(self, why: str) -> None:
        self.newest = Newest((), -math.inf)
        self._fail(f"{self.what} {why}")

    def _watch(self, now_s: float) -> None:
        self._began_s = now_s if self._began_s is None else self._began_s
        if self.fault is None and self.share(now_s) < 1.0:
            if self.newest.values:
                self._fail(f"no {self.what} for {1e3 * self.fresh_s:g} ms")
            elif now_s - self._began_s > PATIENCE_S:
                self._fail(f"no {self.what}: {self._diagnosis()}")

    def _diagnosis(self) -> str:
        """Return why no message came, as far as DDS knows."""
        kinds = set()
        with contextlib.suppress(DDSException):
            found = BuiltinDataReader(self._member, BuiltinTopicDcpsPublication)
            kinds = {each.type_name for each in found.read(1000) if getattr(each, "topic_name", "") == self._topic.name}
        own = self._topic.typename
        if kinds - {own}:
            return f"it carries {', '.join(sorted(kinds - {own}))}, not {own}"
        return "its publisher is silent" if kinds else "nobody publishes it"

    def _fail(self, why: str) -> None:
        if self.fault is None:
            self._tell(f"{why}; the force is zero")
        self.fault = why

    def _tell(self, line: str) -> None:
        now_s = time.monotonic()
        if now_s - self._told_s.get(line, -math.inf) >= LINES_EVERY_S:
            self._told_s[line] = now_s
            LOG.warning(line)

    def close(self) -> None:
        """Leave the topic."""
        self._reader = None


class Output:
    """Messages of one kind to a topic."""

    def __init__(
        self, member: DomainParticipant, topic: str, kind: type[Message], frame_id: str, *, reliable: bool
    ) -> None:
        self._what, self._kind, self._frame_id = f"{kind.__name__} on {topic}", kind, str(frame_id)
        qos = RELIABLE if reliable else BEST_EFFORT
        self._writer: Any = DataWriter(member, Topic(member, PREFIX + topic, kind, qos=TOPIC), qos=qos)
        self._began_s: float | None = None
        self._is_told = False
        self.dropped = 0  # messages that DDS did not take at once

    def send(self, values: tuple[float, ...]) -> None:
        """Send values without waiting."""
        try:
            self._writer.write(made(self._kind, values, self._frame_id))
        except DDSException:  # it would have had to wait
            self.dropped += 1

    def watch(self, now_s: float) -> None:
        """Log once if no subscriber hears it."""
        self._began_s = now_s if self._began_s is None else self._began_s
        if self._is_told or now_s - self._began_s < PATIENCE_S:
            return
        self._is_told = True
        if not self._writer.get_publication_matched_status().current_count:
            refused = self._writer.get_offered_incompatible_qos_status().total_count
            why = "its subscriber asks for reliable messages (reliable=true)" if refused else "nobody subscribes"
            LOG.warning(f"{self._what} is not heard: {why}")

    def close(self) -> None:
        """Leave the topic."""
        self._writer = None
