"""What a master sends of its positions: all of them, or those that matter."""

from dataclasses import asdict
from typing import Any

from hapticnet.codec.positions import Difference, PositionSender, unpack_bound
from hapticnet.codec.schemes.raw import Raw
from hapticnet.errors import PeerError
from hapticnet.node.decoders import with_state
from hapticnet.perception import WeberLaw
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.settings import master_idle_below_n
from hapticnet.samples import Vector
from hapticnet.vectors import magnitude


class Forward:
    """The positions of one master.

    `law`: the whole JND of the person, of which a session grants positions a share.
    """

    def __init__(self, session: MasterSession, law: WeberLaw, axes: int) -> None:
        self.law = law
        self._idle_below_n = master_idle_below_n(law)
        self._session = session
        self._axes = axes
        self._every = Raw().encoder(axes)
        self._sender: PositionSender | None = None
        self._sent = self._ticks = 0

    def begin(self, law: WeberLaw, share: float) -> None:
        """Begin a session that grants positions a share of a JND; 0: every position is sent."""
        self.law = law
        self._idle_below_n = master_idle_below_n(law)
        reasons = self._sender.reasons if self._sender is not None else None
        self._sender = PositionSender(law, share) if share else None
        if self._sender is not None and reasons is not None:
            self._sender.reasons = reasons

    def set_bound(self, bound: bytes) -> None:
        """Take in a stiffness bound. Without one that can be read, every position is sent."""
        if self._sender is None:
            return
        try:
            self._sender.set_bound(unpack_bound(bound, self._axes))
        except PeerError:
            self._session.payload_was_malformed()
            self._sender.set_bound(None)

    @property
    def is_sparse(self) -> bool:
        """Whether positions are sent only when they matter."""
        return self._sender is not None

    def send_every(self, now_us: int, position_m: Vector, state: int | None = None) -> None:
        """Send the position of a tick in a session that sends all; see `send`."""
        self._ticks += 1
        payload = self._every.encode(now_us, position_m)
        if payload is not None:
            self._transmit(now_us, payload, state)

    def is_idle(self, applied_n: Vector) -> bool:
        """Tell whether the force [N] of a session with few positions is so small that a long silence does no harm."""
        return self._sender is not None and magnitude(applied_n) < self._idle_below_n

    def send(
        self,
        now_us: int,
        position_m: Vector,
        applied_n: Vector,
        state: int | None = None,
        difference: Difference | None = None,
    ) -> Vector | None:
        """Send the position of a tick in a session that sends those that matter, if it does.

        Return where the slave takes the tool to be if nothing is lost; None if it does not follow a line.

        `applied_n`: the newest force [N] as the decoder reconstructs it.
        `state`: what the slave must know of the model that is rendered; None: there is none.
        `difference`: see `PositionSender.payload`.
        """
        self._ticks += 1
        sender = self._sender
        assert sender is not None, "every position is to be sent"  # noqa: S101 - the caller's fault
        wanted = self._session.wants_position(now_us)
        payload = sender.payload(now_us, position_m, magnitude(applied_n), wanted=wanted, difference=difference)
        if payload is not None and not self._transmit(now_us, payload, state):
            sender.forget()
        return sender.place_m(now_us)

    def _transmit(self, now_us: int, payload: bytes, state: int | None) -> bool:
        """Send a position; return whether the session takes it."""
        if state is not None:
            payload = with_state(state, payload)
        if not self._session.send_position(now_us, payload):
            return False
        self._sent += 1
        return True

    def report(self) -> dict[str, Any]:
        """Return the account of the positions for JSON."""
        report: dict[str, Any] = {"share": self._sender.share if self._sender else 0.0, "ticks": self._ticks}
        report["sent"] = self._sent
        if self._sender is not None:
            report["reasons"] = asdict(self._sender.reasons)
        return report
