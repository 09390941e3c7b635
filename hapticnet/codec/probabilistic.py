"""The deadband for networks that lose: it says again what the receiver has probably not heard, without being asked.

After Kammerl, Brandi, Schweiger, Steinbach, "Error-resilient perceptual haptic data communication based on
probabilistic receiver state estimation", EuroHaptics 2012, and "Error-resilient perceptual coding for networked haptic
interaction", in which the sender keeps a tree of the cases (received, not received) and their probabilities. Where the
receiver holds, the tree folds into a list: whatever else was lost, it holds the newest update that arrived.
"""

from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import worth_compiling
from hapticnet.codec.base import Encoding
from hapticnet.codec.payload import Form, HoldDecoder, PayloadFormat, check_parameter, check_step, distance
from hapticnet.codec.recording import encode_streamed
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector

MOST_STATES: Final = 16
"""How many updates are remembered. A receiver that holds an older one counts as deviating."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Probabilistic:
    """Transmit what leaves the dead zone, and again while the receiver may well be holding something else.

    With p = `loss_probability` and updates r₁ (newest), r₂, … the receiver holds rⱼ with probability
    ``P(rⱼ) = (1 - p)·pʲ⁻¹``: the newest that arrived, losses being independent. Rule: send x when
    ``|x - r₁| > threshold(|r₁|)``, as the deadband does, or when
    ``Σ P(rⱼ) over all j with |x - rⱼ| > threshold(|rⱼ|)`` exceeds `deviation_limit`, where a receiver that holds
    something older than the 16 newest updates, or nothing yet, counts as deviating. All comparisons are strict.

    What is said again is the *present* stimulus, at the next sample already. While the force moves on, each update is
    said ⌈log(deviation_limit) / log(p)⌉ times; a limit of p or more says nothing twice. It needs no answer, so it
    repairs sooner than a round trip; losses in bursts, which take the repetition as well, are left to the session.
    Without loss the held stimulus is within the threshold at every sample. Payload: as the deadband's.

    Attributes
    ----------
    loss_probability
        Assumed probability of losing a packet, 0 to 0.9; 0: the deadband. The default is an assumption, not a finding.
    deviation_limit
        Probability of a receiver that deviates by more than the threshold, 0.001 to 1, above which is sent again.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "probabilistic"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    loss_probability: float = 0.1
    deviation_limit: float = 0.05
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("loss_probability", self.loss_probability, 0.0, 0.9)
        check_parameter("deviation_limit", self.deviation_limit, 1e-3, 1.0)
        check_step(self.step_n)

    def encoder(self, axes: int) -> "ProbabilisticEncoder":
        """Return a new encoder."""
        return ProbabilisticEncoder(self, PayloadFormat(axes, step_n=self.step_n), axes)

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

            loss, limit = self.loss_probability, self.deviation_limit
            return kernels_holds.probabilistic(self.law, stimuli, loss=loss, limit=limit, step_n=self.step_n)
        return encode_streamed(self, t_us, stimuli, positions)


class ProbabilisticEncoder:
    """Keeps what the receiver may be holding. Satisfies `Encoder`."""

    __slots__ = ("_earlier", "_law", "_limit", "_loss", "_pack", "_reference", "_threshold")

    def __init__(self, codec: Probabilistic, form: Form, axes: int) -> None:
        self._law = codec.law
        self._loss = codec.loss_probability
        self._limit = codec.deviation_limit
        self._pack = form.pack
        self._reference: Vector = (0.0,) * axes
        self._threshold = -1.0
        # Newest first: reference, threshold, probability that it is held, probability that an older one is.
        self._earlier: list[tuple[Vector, float, float, float]] = []

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None where the receiver is probably within the threshold."""
        if distance(stimulus, self._reference) <= self._threshold:
            limit = self._limit
            if self._loss <= limit:
                return None
            doubt = 0.0
            for reference, threshold, held, older in self._earlier:
                if not distance(stimulus, reference) <= threshold:
                    doubt += held
                if doubt + older <= limit:
                    return None
                if doubt > limit:
                    break
        payload, reference, threshold = self._pack(stimulus, self._law)
        loss = self._loss
        if self._threshold >= 0.0:
            known = [(self._reference, self._threshold, 1.0 - loss, loss), *self._earlier[: MOST_STATES - 2]]
            self._earlier = [(value, width, held * loss, older * loss) for value, width, held, older in known]
        self._reference, self._threshold = reference, threshold
        return payload

    def refresh(self) -> None:
        """Forget what the receiver may be holding, so that the next stimulus is sent."""
        self._earlier = []
        self._threshold = -1.0
