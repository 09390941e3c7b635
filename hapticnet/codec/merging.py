"""The deadband with a bound on how fast packets follow one another.

The deadband bounds the average rate only: at an impact every sample may leave the dead zone. After the merging of
samples in Gokhale, Nair, Chaudhuri's congestion control for telehaptics (dynamic packetization module, arXiv
1610.00609) and its successor for adaptive sampling (NaPAS, EuroHaptics 2018). Those carry all merged samples in one
packet and adapt to the network; this one is for a receiver that holds, to which only the newest is worth sending, and
its window is fixed.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import worth_compiling
from hapticnet.codec.base import Encoder, Encoding
from hapticnet.codec.deadband import hold_encoder
from hapticnet.codec.payload import HoldDecoder, PayloadFormat, check_parameter, check_step
from hapticnet.codec.recording import encode_streamed
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector, checked_vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Merging:
    """Transmit what leaves the dead zone, but once a window at most: the newest sample stands for all of them.

    Rule: the deadband's, except that nothing is sent until `window_ms` after the last transmission. The first sample
    at or after the window's end is held against the dead zone as ever; what left it meanwhile and came back is merged
    away. So a change after a pause is sent at once, and no window of `window_ms` holds more than one packet, plus
    those that a repair asks for (`refresh` overrides the window) and those after a time stamp that goes back. On a
    clock that stands still a window never ends.

    Within a window the error is not bounded by the JND: how long, but not how far, a stimulus is away is bounded, and
    its exceedance is above zero by design. Payload: as the deadband's.

    Attributes
    ----------
    window_ms
        Shortest time between two transmissions [ms]; 0: the deadband. The default, at most 100 packets a second, is
        an assumption of ours, to be set to what the network bears.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "merging"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    window_ms: float = 10.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("window_ms", self.window_ms, 0.0, 1e4)
        check_step(self.step_n)

    def encoder(self, axes: int) -> "MergingEncoder":
        """Return a new encoder."""
        deadband = hold_encoder(self.law, PayloadFormat(axes, step_n=self.step_n), axes)
        return MergingEncoder(deadband, self.window_ms * 1e3)

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder."""
        return HoldDecoder(PayloadFormat(axes, step_n=self.step_n), axes)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        stimuli = as_recording(stimuli)
        if worth_compiling(stimuli, t_us):
            from hapticnet.codec import kernels_holds

            return kernels_holds.merging(self.law, t_us, stimuli, window_ms=self.window_ms, step_n=self.step_n)
        return encode_streamed(self, t_us, stimuli, positions)


class MergingEncoder:
    """Asks a deadband encoder outside the window only. Satisfies `Encoder`."""

    __slots__ = ("_deadband", "_sent_us", "_window_us")

    def __init__(self, deadband: Encoder, window_us: float) -> None:
        self._deadband = deadband
        self._window_us = window_us
        self._sent_us = -math.inf

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload, or None inside the dead zone or the window."""
        if 0.0 <= t_us - self._sent_us < self._window_us:
            for component in stimulus:
                if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
                    checked_vector(stimulus, "stimulus")
            return None
        payload = self._deadband.encode(t_us, stimulus, position)
        if payload is not None:
            self._sent_us = t_us
        return payload

    def refresh(self) -> None:
        """Empty the dead zone and end the window, so that the next stimulus is sent."""
        self._sent_us = -math.inf
        self._deadband.refresh()
