"""What a hand feels over a network: the applied force at each tick, compared with the true force.

A position takes time to reach the slave, and the force that it causes takes time to come back. Meanwhile the hand moves
on. The error of a codec does not show this; this measure does. It needs a recorded hand: its positions, and the
true force of each. Sessions, keepalives and the decay of a stale link are omitted, to show the codec's share.
"""

from typing import Final, NamedTuple

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import ChannelSettings
from hapticnet.codec.base import Codec, Delayed
from hapticnet.errors import PeerError
from hapticnet.node.decoders import receiver
from hapticnet.node.hand_predictor import ForceAhead
from hapticnet.protocol.stats import RoundTrip
from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.base import Touchable

POSITION_BYTES: Final = 20  # size of a datagram with a position [B], for a bottleneck


class Felt(NamedTuple):
    """Messages and applied forces over a network."""

    applied: FloatArray  # stimulus [N] applied at each tick, after all arrivals so far, shape (n, a)
    sent: int  # updates sent, and those that the decoder received
    received: int


class _Update(NamedTuple):
    """A payload, its number, and the time [µs] of the position that it answers."""

    number: int
    t_us: int
    payload: bytes


def simulate_link(
    codec: Codec,
    t_us: IntArray,
    stimuli: FloatArray,
    positions: FloatArray | None = None,
    *,
    forward: ChannelSettings,
    feedback: ChannelSettings,
    repair_us: int,
    rng: np.random.Generator,
    scene: Touchable | None = None,
) -> Felt:
    """Play a recorded hand over a network: a master with a tick at each sample, and a slave that answers on arrival.

    `stimuli`: true stimulus at each tick [N], shape (n, a).
    `positions`: position of the tool at each tick [m], shape (n, a), if known.
    `repair_us`: time [µs] after which the slave knows that an update was lost. It then sends the next stimulus, unless
    a later update got through.
    `scene`: what the hand touches, at rest: the slave answers for where the hand will be, on a copy of it; None: for
    its last position.
    Raise SampleError if the codec refuses a sample.
    """
    link = _Link(codec, t_us, stimuli, positions, forward, feedback, repair_us, rng, scene)
    applied = np.array([link.tick(index) for index in range(len(t_us))], dtype=np.float64).reshape(stimuli.shape)
    return Felt(applied, link.sent, link.received)


class _Link:
    """Slave, master and two channels that play one recording."""

    def __init__(
        self,
        codec: Codec,
        t_us: IntArray,
        stimuli: FloatArray,
        positions: FloatArray | None,
        forward: ChannelSettings,
        feedback: ChannelSettings,
        repair_us: int,
        rng: np.random.Generator,
        scene: Touchable | None,
    ) -> None:
        axes = stimuli.shape[1]
        self._times_us: list[int] = t_us.tolist()
        self._stimuli: list[Vector] = list(zip(*stimuli.T.tolist(), strict=True))
        self._positions: list[Vector | None] = [None] * len(stimuli)
        if positions is not None:
            self._positions = list(zip(*positions.T.tolist(), strict=True))
        self._encoder, self._decoder = codec.encoder(axes), receiver(codec, axes, predicted=scene is not None)
        forward_rng, feedback_rng = rng.spawn(2)
        self._forward = Emulator[tuple[int, int]](forward, forward_rng)
        self._feedback = Emulator[_Update](feedback, feedback_rng)
        self._repair_us = repair_us
        self._newest = -1
        self._missing_since_us: int | None = None
        self._heard: tuple[int, int] | None = None  # the time of the newest update, and its arrival
        self.sent = self.received = 0
        self._named = 0
        self._scene = scene
        period_us = self._times_us[1] - self._times_us[0] if len(self._times_us) > 1 else 1000
        self._ahead = None if scene is None else ForceAhead(scene, period_us, codec.law)
        self._round_trip = RoundTrip()

    def tick(self, index: int) -> Vector:
        """Send the position of a tick, process all arrivals so far, and return the applied force."""
        now_us = self._times_us[index]
        self._forward.push((index, self._named), POSITION_BYTES, now_us)
        while True:
            timers = self._forward.next_timer_us(), self._feedback.next_timer_us()
            due_us = min((timer for timer in timers if timer is not None), default=now_us + 1)
            if due_us > now_us:
                break
            for position, named in self._forward.due(due_us):
                self._round_trip.named(named, due_us)
                self._answer(position, due_us)
            for update in self._feedback.due(due_us):
                self._receive(update, due_us)
        at_us = now_us
        if self._heard is not None:  # a prediction for the newest position that may have been answered
            t_us, heard_us = self._heard
            at_us = t_us + now_us - heard_us
        return self._decoder.reconstruct(at_us, self._positions[index], now_us)

    def _answer(self, index: int, now_us: int) -> None:
        """Let the slave answer the position of a tick, unless it has answered a later one."""
        if index <= self._newest:
            return
        self._newest = index
        since_us = self._missing_since_us
        if since_us is not None and now_us - since_us >= self._repair_us:
            self._encoder.refresh()
            self._missing_since_us = None
        t_us = self._times_us[index]
        stimulus, position, round_trip_us = self._stimuli[index], self._positions[index], self._round_trip.us
        if self._scene is not None and self._ahead is not None and position is not None:
            at = PositionSample(t_us, position)
            self._scene.step(at)
            predicted = self._ahead.answer(at, t_us, round_trip_us)
            if predicted is not None:
                round_trip_us, (position, stimulus) = 0, predicted
        if isinstance(self._encoder, Delayed):
            self._encoder.set_round_trip(round_trip_us)
        payload = self._encoder.encode(t_us, stimulus, position)
        if payload is None:
            return
        self.sent += 1
        self._round_trip.sent(self.sent, now_us)
        lost = self._feedback.counters.lost
        self._feedback.push(_Update(self.sent, t_us, payload), len(payload), now_us)
        if self._feedback.counters.lost == lost:
            self._missing_since_us = None
        elif self._missing_since_us is None:
            self._missing_since_us = now_us

    def _receive(self, update: _Update, now_us: int) -> None:
        """Decode an update at the master, unless it has a later one."""
        if self._heard is not None and update.t_us <= self._heard[0]:
            return
        try:
            self._decoder.decode(update.t_us, update.payload)
        except PeerError:  # it builds on a lost update
            if self._missing_since_us is None:
                self._missing_since_us = now_us
            return
        self.received += 1
        self._named = update.number
        self._heard = update.t_us, now_us
