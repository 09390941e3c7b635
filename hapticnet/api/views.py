"""What a program sees of a master or slave at work, however it is run."""

from typing import Any, Generic, TypeVar

from hapticnet.api.inputs import as_codec, served
from hapticnet.api.master_setup import Hand, PositionLike
from hapticnet.codec import registry
from hapticnet.codec.base import Codec
from hapticnet.errors import RefusedError, SettingsError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode
from hapticnet.samples import Vector

Node = TypeVar("Node", MasterNode, SlaveNode)


class NodeView(Generic[Node]):
    """A node at work, or none."""

    _node: Node | None = None

    @property
    def node(self) -> Node:
        """The node itself, for what is not shown here; its interface may change.

        Raises
        ------
        UnavailableError
            If it is not running.
        """
        if self._node is None:
            raise UnavailableError(f"this {type(self).__name__} is not running; enter it with 'with' or 'async with'")
        return self._node


class MasterView(NodeView[MasterNode]):
    """A master at work: where the tool is, what is felt, and how the session is."""

    _hand: Hand | None = None

    @property
    def position(self) -> Vector | None:
        """Position [m] of the newest tick, one value for each axis; None before there is a session. Assign to move.

        Raises
        ------
        SampleError
            On assignment of what is not finite or has another number of axes.
        SettingsError
            On assignment if an operator gives the positions.
        """
        return self._hand.position_m if self._hand is not None else self.node.position_m

    @position.setter
    def position(self, position: PositionLike) -> None:
        if self._hand is None:
            if self._node is None:
                raise UnavailableError(f"this {type(self).__name__} is not running")
            raise SettingsError("an operator gives the positions of this master")
        self._hand.move(position)

    @property
    def force_n(self) -> Vector:
        """Force [N] that is held, one value for each axis; it decays to zero when the link goes stale."""
        return self.node.held_n

    @property
    def connected(self) -> bool:
        """Whether there is a session now, stale or not."""
        return self.node.session.streaming

    @property
    def state(self) -> str:
        """State of the session: connecting, established, stale, closing or closed."""
        return self.node.session.state.value

    @property
    def scene(self) -> str | None:
        """What the slave calls the scene; None before there is a session."""
        return self.node.scene_name

    @property
    def ended(self) -> str | None:
        """Why the session is over for good; None while it is not."""
        return self.node.end_reason

    @property
    def paused(self) -> str | None:
        """Why the operator is not asked for positions; None if it is."""
        return self.node.paused

    def report(self) -> dict[str, Any]:
        """Return the account of this master, as ``hapticnet master --json`` prints it.

        None for what it does not have, such as `end_reason` while it runs.

        Raises
        ------
        UnavailableError
            If it is not running.
        """
        return {**self._report(self.node), "provenance": provenance()}

    def _report(self, node: MasterNode) -> dict[str, Any]:
        raise NotImplementedError

    def change(
        self,
        *,
        codec: str | Codec | None = None,
        weber_fraction: float | None = None,
        floor_n: float | None = None,
        multiplier: float | None = None,
    ) -> None:
        """Ask for another codec or JND while the session runs. What is not given stays; the scene stays as it is.

        `Connected` or `ChangeRefused` follows as an event.

        Raises
        ------
        SettingsError
            If there is no such codec, or a value is out of range.
        """
        now = self.node.codec
        law = now.law
        if codec is not None and not isinstance(codec, str):
            given = {"weber_fraction": weber_fraction, "floor_n": floor_n, "multiplier": multiplier}
            chosen = served(as_codec(codec, **given, parameters={}))
        else:
            same = codec is None or codec == now.name
            chosen = as_codec(
                now.name if codec is None else codec,
                weber_fraction=law.weber_fraction if weber_fraction is None else weber_fraction,
                floor_n=law.floor_n if floor_n is None else floor_n,
                multiplier=law.multiplier if multiplier is None else multiplier,
                parameters=registry.codec_parameters(now) if same else {},
            )
        self.node.change(codec=chosen.name, parameters=registry.codec_parameters(chosen), law=chosen.law)

    def resume(self) -> None:
        """Ask the operator for positions again after `Paused`; the force rises from zero."""
        self.node.resume()

    def _check_alive(self) -> None:
        """Raise the error that ended the session, if it has ended."""
        node = self.node
        if node.refused:
            raise RefusedError(f"the slave refused the session: {node.end_reason}")
        if node.finished:
            raise UnavailableError(f"the session has ended: {node.failure or node.end_reason}")


class SlaveView(NodeView[SlaveNode]):
    """A slave at work.

    Attributes
    ----------
    address
        Where it listens, HOST:PORT; empty if it does not.
    """

    address: str = ""

    @property
    def connected(self) -> tuple[str, ...]:
        """Names of the masters that have a session now."""
        return tuple(context.session.request.name for context in self.node.contexts if context.seated)

    def report(self) -> dict[str, Any]:
        """Return the account of all sessions, as ``hapticnet slave --json`` prints it; raise as for a master."""
        return {**self._report(self.node), "provenance": provenance()}

    def _report(self, node: SlaveNode) -> dict[str, Any]:
        raise NotImplementedError

    def resume(self) -> None:
        """Step the scenes again that have failed and are paused."""
        self.node.resume()
