"""The force that a master applies: decoded from what arrives, held in between, and how old it is."""

from typing import Any

from hapticnet.codec.base import Codec, Decoder, Foretelling
from hapticnet.codec.positions.sending import Difference
from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.node.announced import AnnouncedDecoder
from hapticnet.node.elsewhere import Elsewhere
from hapticnet.node.foresight import Foresight
from hapticnet.protocol.events import ForceArrived, HoldConfirmed
from hapticnet.protocol.stats import Distribution
from hapticnet.samples import Vector


class AppliedForce:
    """The decoder of a session and the hold behind it.

    Attributes
    ----------
    received_n
        Force [N] of all axes as the decoder reconstructs it.
    age
        Age [µs] of the force that is applied, in each tick.
    value
        Returns the force being held [N] at a time [µs], decayed where the link is stale.
    ticks_on_model
        Ticks in which the force was that of an announced model.
    """

    def __init__(self, codec: Codec, settings: HoldSettings, axes: int) -> None:
        self.received_n: Vector = (0.0,) * axes
        self.age = Distribution()
        self.ticks_on_model = 0
        self._axes = axes
        self._decoder: Decoder = codec.decoder(axes)
        self._announced: AnnouncedDecoder | None = None
        self._elsewhere: Elsewhere | None = None
        self._foresight = Foresight(axes)
        self._hold = Hold(settings, axes=axes)
        self._heard_us: int | None = None  # when the newest force arrived, on the master's clock
        self._heard_t_us = 0  # and its time stamp
        self._position_m: Vector | None = None  # of the newest tick, and its time
        self._position_us = 0
        self._at_us = 0  # time for which the decoder was asked last
        self._asked: Decoder | None = None  # the decoder of which it is known whether it foretells
        self._foretells = False
        self.value = self._hold.value  # without another call, because every tick takes it
        self._valid_t_us = 0  # time of the newest position for which what is applied is known to be right

    @property
    def on_model(self) -> bool:
        """Whether the force is that of an announced model."""
        return self._announced is not None and self._announced.on_model

    def begin(self, codec: Codec, stiffest_n_per_m: float | None = None, *, on_a_line: bool = False) -> None:
        """Begin a session: what is held stays until the first force arrives.

        `stiffest_n_per_m` is the limit of models of the contact ahead [N/m]; None if nothing is announced. `on_a_line`
        tells whether positions are sent only when they matter.
        """
        self._decoder, self._announced = codec.decoder(self._axes), None
        if stiffest_n_per_m is not None:
            self._decoder = self._announced = AnnouncedDecoder(self._decoder, self._axes, stiffest_n_per_m)
        self._elsewhere = Elsewhere(codec, self._axes, stiffest_n_per_m) if on_a_line else None
        self._foresight = Foresight(self._axes)
        self._heard_us = None
        self._hold.restart()

    def move(self, now_us: int, position_m: Vector) -> int | None:
        """Move the tool; return which layers of an announced model are pierced, or None if nothing is announced."""
        if self._announced is None:
            return None
        self._announced.move(now_us, position_m)
        return self._announced.state

    def difference(self, now_us: int, period_us: int, position_m: Vector) -> Difference | None:
        """Return how what is applied depends on where the tool has been; None if it does not."""
        elsewhere, decoder = self._elsewhere, self._rendering
        if elsewhere is None or not isinstance(decoder, Foretelling):
            return None
        at_us = self._time_us(now_us, period_us)
        here_n = decoder.foretell(at_us, position_m, now_us)
        return lambda place_m: elsewhere.difference(here_n, at_us, place_m, now_us)

    def follow(self, now_us: int, period_us: int, place_m: Vector | None) -> None:
        """Note where the slave takes the tool to be; None if it does not follow a line."""
        if self._elsewhere is not None and place_m is not None:
            self._elsewhere.move(self._time_us(now_us, period_us), place_m, now_us)

    def take_in(self, event: ForceArrived, now_us: int) -> None:
        """Apply a force that has arrived.

        Raises
        ------
        PeerError
            If its payload is malformed. A user's codec may raise anything.
        """
        self._decoder.decode(event.t_us, event.payload)
        if self._elsewhere is not None:
            self._elsewhere.decode(event.t_us, event.payload)
        self.received_n = self._decoder.reconstruct(event.t_us, self._position_m, self._position_us)
        self._hold.receive(self.received_n, now_us)
        if not self.on_model:  # a model's force is that of now
            self._foresight.learn(event.t_us, self.received_n)
        self._heard_us, self._heard_t_us = now_us, event.t_us
        self._valid_t_us = event.t_us

    def confirm(self, event: HoldConfirmed, now_us: int) -> None:
        """Note that what is applied was still right at a position."""
        if self._heard_us is not None:  # else what is held is of an earlier session, and nobody confirms that
            self._hold.confirm(now_us)
            self._valid_t_us = event.t_us

    def keep(self, now_us: int) -> None:
        """Do not let the stimulus grow old: it is too small to be felt, and what follows it must not have to rise."""
        if self._heard_us is not None:
            self._hold.confirm(now_us)

    def advance(self, now_us: int, period_us: int, position_m: Vector | None) -> None:
        """Follow the decoder for a tick at a position. A user's codec may raise anything."""
        self._position_m, self._position_us = position_m, now_us
        if self._heard_us is None:
            return
        late_us = now_us - self._heard_us - period_us  # as `_time_us`
        self._at_us = at_us = self._heard_t_us + late_us if late_us > 0 else self._heard_t_us
        self.received_n = force_n = self._decoder.reconstruct(at_us, position_m, now_us)
        announced = self._announced
        if announced is not None and announced.on_model:
            self.ticks_on_model += 1
        if self._hold.follow(force_n, now_us):
            self.age.add(now_us - self._valid_t_us)

    def expected(self, now_us: int, lead_us: int) -> Vector:
        """Return the force [N] expected `lead_us` from now; the held one unless the link is alive and all of it held.

        Called once a tick, after `advance`. A user's codec may raise anything.
        """
        if self._position_m is not None:
            self._foresight.move(now_us, self._position_m)
        if not self._hold.is_fresh(now_us):
            return self._hold.value(now_us)
        decoder = self._rendering
        if decoder is not self._asked:  # a question that takes long
            self._asked, self._foretells = decoder, isinstance(decoder, Foretelling)
        foretell = self._foretell if self._foretells else None
        return self._foresight.expected(now_us, self._at_us, lead_us, self.received_n, foretell)

    @property
    def _rendering(self) -> Decoder:
        return self._decoder if self._announced is None else self._announced.rendering

    def _time_us(self, now_us: int, period_us: int) -> int:
        """Return the time [µs] of the newest position whose answer could have arrived by now.

        A prediction for that time is not contradicted; the answer to the next position comes within this period.
        """
        if self._heard_us is None:
            return now_us
        return self._heard_t_us + max(0, now_us - self._heard_us - period_us)

    def _foretell(self, lead_us: int, position_m: Vector) -> Vector:
        """Return what the decoder foretells [N] for a position [m] ahead."""
        decoder: Any = self._rendering  # one that foretells
        force_n: Vector = decoder.foretell(self._at_us + lead_us, position_m, self._position_us + lead_us)
        return force_n

    def release(self) -> None:
        """Let the force go to zero; it rises from there."""
        self._hold.release()
