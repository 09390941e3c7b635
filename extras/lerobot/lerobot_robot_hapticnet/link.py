"""One session that the robot and the teleoperator of a process share.

LeRobot's loops take an action and send it to the robot 30 or 60 times a second, and pass no force back. So a
teleoperator that has the same address as a robot moves that robot's session directly, in every tick, and feels the
force in the same tick. LeRobot's loop reads and records both.
"""

import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import asdict, fields
from socket import gethostname
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakValueDictionary

from lerobot.utils.errors import DeviceNotConnectedError

import hapticnet as hn
from hapticnet.capabilities import Capabilities
from hapticnet.errors import HapticnetError, SettingsError
from hapticnet.operator.base import operator_parts
from hapticnet.parts import LEVER_M, written
from hapticnet.protocol.states import LinkRecovered, LinkStale, SessionLost
from hapticnet.rotations import quaternion_of, vector_near
from hapticnet.runtime.system import now_us
from lerobot_robot_hapticnet.config import Joints, Session

if TYPE_CHECKING:
    from hapticnet.cli.operators import Hand

LOG: Final = logging.getLogger("hapticnet")
SILENT_S: Final = 0.5  # time without an action after which a tool without a hand lets go
LONGEST_RAMP_S: Final = 0.1  # longest time in which the tool moves to an action; else the time since the last one
IDLE_S: Final = 0.05  # time without a tick after which the force is zero
FASTEST_M_PER_S: Final = 0.5
GIVES_M_PER_N_S: Final = 0.005  # speed per newton at which a tool that lets go yields; stable to 1 kN/m at 300 ms
LEAST_N: Final = 0.05  # a torque counts as its force at `LEVER_M` in these three
FIRST_S: Final = 2.0  # longest wait for the first answer of the slave
FRESH_S: Final = 0.1  # age of a feedback from which its force decays, to zero at twice this age
MOTION: Final = tuple(each.name for each in fields(Joints))
SHARED: Final = *MOTION, "codec", "coupling", "predicted", "rate_hz", "key", "peer_key", "insecure"
"""Settings that must be the same for robot and teleoperator."""

HISTORY: Final = 2000  # ticks whose positions are kept


class Tool:
    """The operator of the session: the hand if there is one, or else the newest action, reached in small steps."""

    duration_us = None

    def __init__(self, joints: Joints, hand: "Hand | None") -> None:
        self.parts = joints.parts
        self._hand = hand
        if hand is not None:
            self.capabilities = getattr(hand.operator, "capabilities", Capabilities(axes=joints.turn_at.start))
        self._turn_at = joints.turn_at if joints.has_vector else slice(0)
        self._levers_m = joints.by_kind(1.0, LEVER_M, 1.0)
        self.force_n: tuple[float, ...] = (0.0,) * len(joints.names)
        self.at: tuple[float, ...] = self.force_n  # [m, rad, m]
        self.past: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=HISTORY)
        self._from = self._to = self.at
        self._begun_s = self._told_s = time.monotonic()
        self._span_s = 1e-3
        self._then_s = self._begun_s
        self._told = self._let_go = False
        self._felt_us = 0
        self._feel: Any = None if hand is None else getattr(hand.operator, "feel", None)

    def move(self, position: tuple[float, ...]) -> None:
        """Go to a position [m, rad, m]."""
        now_s = time.monotonic()
        turned = self._turn_at
        if position[turned]:  # the nearest of the equal rotation vectors
            near = vector_near(quaternion_of(position[turned]), self.at[turned])
            position = *position[: turned.start], *near, *position[turned.stop :]
        far_m = max(lever * abs(to - at) for lever, to, at in zip(self._levers_m, position, self.at, strict=True))
        self._span_s = max(min(now_s - self._told_s, LONGEST_RAMP_S), 1e-3, far_m / FASTEST_M_PER_S)
        self._from, self._to = self.at, position
        self._begun_s = self._told_s = now_s
        self._told, self._let_go = True, False

    def feel(self, t_us: int, force_n: tuple[float, ...]) -> None:
        """Take the force of this tick."""
        self.force_n, self._felt_us = force_n, t_us
        if self._feel is not None:
            self._feel(t_us, force_n)
        if self._hand is not None:
            for watcher in self._hand.watchers:
                watcher.observe(now_us())

    def rest(self) -> None:
        """Set the force to zero if no tick came for a while: the ticks of a lost session do not reach its operator."""
        if time.monotonic() - self._then_s > IDLE_S:
            self.feel(self._felt_us, (0.0,) * len(self.at))

    def sample(self, t_us: int) -> tuple[float, ...]:
        """Return where the tool is."""
        now_s = time.monotonic()
        if self._hand is not None:
            self.at = self._hand.operator.sample(t_us).position_m
        elif self._told and now_s - self._told_s > SILENT_S:
            if not self._let_go:
                self._let_go = True
                LOG.warning("no action for %g s: the tool lets go until there is one", SILENT_S)
            elapsed_s = min(now_s - self._then_s, 0.02)
            self.at = tuple(
                at - GIVES_M_PER_N_S * elapsed_s * force / lever**2 if abs(force) > LEAST_N * lever else at
                for at, force, lever in zip(self.at, self.force_n, self._levers_m, strict=True)
            )
        else:
            share = min((now_s - self._begun_s) / self._span_s, 1.0)
            self.at = tuple(at + share * (to - at) for at, to in zip(self._from, self._to, strict=True))
        self._then_s = now_s
        self.past.append((round(1e6 * now_s), self.at))
        return self.at


class Feedback:
    """The scene of a teleoperator without an address: the force given to `send_feedback`, while it is fresh."""

    name = "feedback of LeRobot"

    def __init__(self, joints: Joints) -> None:
        self.parts = joints.parts
        self._nothing = (0.0,) * len(joints.names)
        self._force_n = self._nothing
        self._told_s: float | None = None

    def tell(self, force_n: tuple[float, ...]) -> None:
        """Render these forces [N] and torques [N·m] from now on."""
        self._force_n, self._told_s = force_n, time.monotonic()

    def step(self, sample: hn.PositionSample) -> Sequence[float]:  # noqa: ARG002 - the force does not depend on it
        """Return the force."""
        told_s = self._told_s
        if told_s is None:
            return self._nothing
        share = min(max(2.0 - (time.monotonic() - told_s) / FRESH_S, 0.0), 1.0)
        if not share:
            self._told_s = None
            if any(self._force_n):
                LOG.warning("no feedback for %g s: the force is zero", 2.0 * FRESH_S)
        return tuple(share * each for each in self._force_n)


class _Master(hn.ThreadedMaster):
    """A master that also runs the connection of its hand, such as the one to Haply's service."""

    hand: "Hand | None" = None
    tool: Tool

    @asynccontextmanager
    async def _live(self) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            resting = asyncio.create_task(self._let_rest())
            stack.callback(resting.cancel)
            for watcher in () if self.hand is None else self.hand.watchers:
                await watcher.start()
                stack.push_async_callback(watcher.stop)
            await stack.enter_async_context(super()._live())
            yield

    async def _let_rest(self) -> None:
        while True:
            await asyncio.sleep(IDLE_S / 2.0)
            self.tool.rest()


class Link:
    """The session with one address, which the robot and the teleoperator of a process share."""

    def __init__(self, config: Session) -> None:
        self._config = config
        self._nothing = (0.0,) * len(config.names)
        self.hand = ""  # text of the hand; empty: the program moves the tool
        self.tool: Tool | None = None
        self.feedback: Feedback | None = None
        self._users: set[int] = set()
        self._slave: hn.ThreadedSlave | None = None
        self._master: _Master | None = None
        self._lost: str | None = None

    @classmethod
    def of(cls, config: Session) -> "Link":
        """Return the link of a configuration; SettingsError if this process has another session with its address."""
        link = _LINKS.get(config.address) if config.address else None
        if link is None:
            link = cls(config)
            if config.address:
                _LINKS[config.address] = link
        mine, other = asdict(config), asdict(link._config)
        for name in SHARED:
            if mine[name] != other[name]:
                raise SettingsError(
                    f"robot and teleoperator share the session with {config.address}, but {name} is"
                    f" {mine[name]!r} at one and {other[name]!r} at the other"
                )
        return link

    def open(self, user: object) -> None:
        """Open the session unless it is open; a HapticnetError says why it cannot be opened."""
        if self._master is None:
            self._begin()
        self._users.add(id(user))

    def is_open(self, user: object) -> bool:
        """Return whether this user has opened the session and not left it."""
        return id(user) in self._users

    def leave(self, user: object) -> None:
        """Leave the session; if no user is left, close it, which sets the force to zero."""
        self._users.discard(id(user))
        if not self._users:
            self._end()

    def check(self, user: object) -> Tool:
        """Return the tool, and log what happened to the session; DeviceNotConnectedError if there is no session."""
        master, tool = self._master, self.tool
        if not self.is_open(user) or master is None or tool is None:
            raise DeviceNotConnectedError("hapticnet is not connected; call connect() first")
        for event in master.take_events():
            if isinstance(event, LinkStale):
                LOG.warning("nothing arrives from %s: the force is zero", master.address)
            elif isinstance(event, LinkRecovered):
                LOG.warning("%s answers again", master.address)
            elif isinstance(event, SessionLost):
                self._lost = event.reason
        if self._lost is not None or master.ended is not None:
            raise DeviceNotConnectedError(f"{master.address} ended the session: {self._lost or master.ended}")
        return tool

    @property
    def is_busy(self) -> bool:
        """Whether a user has it open."""
        return bool(self._users)

    @property
    def force_n(self) -> tuple[float, ...]:
        """Force [N], torque [N·m] and grip [N] that the hand feels; they decay to zero when nothing arrives."""
        return self._nothing if self._master is None or self._lost is not None else self._master.force_n

    def answered(self) -> tuple[float, ...]:
        """Return the position that was sent one median round trip ago, to which the present force belongs."""
        assert self.tool is not None and self._master is not None  # noqa: S101, PT018 - for the type checker
        wanted_us = round(1e6 * time.monotonic()) - self._round_trip_us()
        for t_us, position in reversed(tuple(self.tool.past)):
            if t_us <= wanted_us:
                return position
        return self.tool.at

    def report(self) -> dict[str, Any]:
        """Return the account of the session, as ``hapticnet master --json`` prints it."""
        if self._master is None:
            raise DeviceNotConnectedError("hapticnet is not connected; call connect() first")
        return self._master.report()

    def _round_trip_us(self) -> int:
        master = self._master
        assert master is not None  # noqa: S101 - for the type checker

        async def ask() -> float:  # runs on the event loop, because the session belongs to its thread
            return master.node.session.round_trip.percentile(50) or 0.0

        return round(master._wait_for(ask()))

    def _begin(self) -> None:
        config = self._config
        hand = operator_of(self.hand) if self.hand else None
        if hand is not None:
            has, needs = written(operator_parts(hand.operator), hand.operator.axes), " ".join(config.parts)
            if has != needs:
                raise SettingsError(f"the hand {self.hand!r} has {has}, but {', '.join(config.names)} need {needs}")
        tool, address = Tool(config, hand), config.address
        if not address:
            self.feedback = Feedback(config)
            self._slave = hn.ThreadedSlave(self.feedback, listen="127.0.0.1:0").__enter__()
            address = self._slave.address
        # Without a hand the force moves nothing, so nothing can oscillate and no coupling is needed.
        coupling = "direct" if hand is None else config.coupling
        master = _Master(
            address, operator=tool, codec=config.codec if config.address else "raw", coupling=coupling,
            predicted=config.predicted, rate_hz=config.rate_hz, key=config.key,
            peer_key=config.peer_key, insecure=config.insecure,
            name=f"LeRobot {gethostname()}",
        )  # fmt: skip
        master.hand, master.tool, self._lost = hand, tool, None
        try:
            self._master = master.__enter__()
        except BaseException:
            self._end()
            raise
        self.tool = tool
        # The follower counts positions from the first that arrives. It must be 0, for actions to be absolute positions.
        end_s = time.monotonic() + FIRST_S
        while hand is None and not self._round_trip_us() and time.monotonic() < end_s:
            time.sleep(0.005)

    def _end(self) -> None:
        for each in (self._master, self._slave):
            if each is not None:
                each.__exit__(None, None, None)
        self._master = self._slave = None
        self.tool = self.feedback = None


_LINKS: "WeakValueDictionary[str, Link]" = WeakValueDictionary()  # by address


def operator_of(text: str) -> "Hand":
    """Return the hand that ``hapticnet master --operator`` would take."""
    from hapticnet.cli.operators import make_operator

    return make_operator(text, insertions=10_000, seed=0, say=LOG.info, warn=LOG.warning)


def connecting(link: Link, user: object) -> None:
    """Open a link; DeviceNotConnectedError, in one line, if that fails."""
    try:
        link.open(user)
    except HapticnetError as error:
        raise DeviceNotConnectedError(str(error)) from error
