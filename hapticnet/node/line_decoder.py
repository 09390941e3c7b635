"""What a master would apply at the places where its slave takes the tool to be.

The slave follows the line that the master promised, and judges what its decoder applies there. A decoder that knows the
position applies something else at the tool, so the master runs a second one along the line.
"""

from hapticnet.codec.base import Codec, Decoder, Predictive
from hapticnet.errors import PeerError
from hapticnet.node.announced import Allowance, AnnouncedDecoder
from hapticnet.samples import Vector
from hapticnet.vectors import minus


class LineDecoder:
    """A second decoder of a session, which is where the slave takes the tool to be.

    Parameters
    ----------
    stiffest_n_per_m
        Limit of models of the contact ahead [N/m]; None if nothing is announced.
    allowance
        That of the master's own decoder, which may therefore apply a model some positions earlier.
    """

    __slots__ = ("_announced", "_decoder")

    def __init__(self, codec: Codec, axes: int, stiffest_n_per_m: float | None, allowance: Allowance) -> None:
        self._announced: AnnouncedDecoder | None = None
        # A decoder that does not know the position applies the same everywhere.
        self._decoder: Decoder | None = codec.decoder(axes) if codec.needs_position else None
        if stiffest_n_per_m is not None:
            inner = self._decoder or codec.decoder(axes)
            self._decoder = self._announced = AnnouncedDecoder(inner, axes, stiffest_n_per_m, allowance)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload that the master's own decoder has taken in."""
        if self._decoder is None:
            return
        try:
            self._decoder.decode(t_us, payload)
        except PeerError:  # a model, but this decoder has not been anywhere yet
            return

    def move(self, t_us: int, place_m: Vector, place_us: int) -> None:
        """Note where the slave takes the tool to be: to be called at each tick."""
        if self._announced is not None:
            self._announced.move(place_us, place_m)
        if self._decoder is not None:
            self._decoder.reconstruct(t_us, place_m, place_us)

    def difference(self, here_n: Vector, t_us: int, place_m: Vector, place_us: int) -> Vector | None:
        """Return by how much `here_n` differs from the force at a place [N]; None if that cannot be."""
        decoder = self._decoder if self._announced is None else self._announced.rendering
        if not isinstance(decoder, Predictive):
            return None
        return minus(here_n, decoder.predict(t_us, place_m, place_us))
