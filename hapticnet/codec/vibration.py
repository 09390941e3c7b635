"""Vibration beside force: frames of the acceleration of one axis, quantised by what a hand can feel.

A frame is transformed by an orthonormal DCT-II without overlap. It decodes alone, can be sent as soon as it ends, and
its error is within half a quantiser step in every coefficient. Long blocks, wavelets or overlapping transforms save
bytes on long texture, but arrive later, and a lost one costs its neighbours too.

**Sensitivity.** The weakest amplitude that is felt, as an acceleration, is constant up to 250 Hz and rises by 24 dB per
octave above. G. A. Gescheider and R. T. Verrillo, "Vibrotactile frequency characteristics as determined by adaptation
and masking procedures", 1979: as a displacement, the threshold of the palm is flat up to 40 Hz, then falls by 12 dB per
octave to its least at about 250 Hz. From 40 Hz on that is a constant acceleration; below, where the held force acts, it
is kept constant. VC-PWQ, the tactile codec of IEEE 1918.1.1 (A. Noll, B. Gülecyüz, A. Hofmann and E. Steinbach, "A
rate-scalable perceptual wavelet-based vibrotactile codec", 2020), has the threshold 62·(lg(f/550 + 6/11) / lg(6/11))² -
77 dB. From 250 to 500 Hz it rises by 23.7 dB, as this one. Below, it rises as a displacement does, and this codec gets
accelerations; at 1 kHz it would let nothing pass.

The default of 0.1 m/s² is an assumption between two measurements: 0.25 m/s² for a probe at the palm (0.1 µm at 250 Hz;
S. J. Bolanowski, G. A. Gescheider, R. T. Verrillo and C. M. Checkosky 1988) and less than 0.02 m/s² for some persons
who hold a rod (less than 0.01 µm at 150 to 200 Hz; A. J. Brisben, S. S. Hsiao and K. O. Johnson 1999). These stimuli
lasted longer than a frame; shorter ones must be stronger to be felt.

**Masking.** Beside a strong vibration a weak one is not felt, so the error may have a share of the frame's level:
`WEBER`, the least of the median difference thresholds of 0.20 to 0.58 that N. G. Forta, M. J. Griffin and M. Morioka
found ("Vibrotactile difference thresholds", 2012).
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_parameter
from hapticnet.errors import PeerError, SampleError

RATE_HZ: Final = 2800
"""Samples a second, as in IEEE 1918.1.1: for a bandwidth of 1 kHz."""

FRAME: Final = 28  # samples of a frame
FRAME_US: Final = 10_000  # their time [µs]
LARGEST_M_S2: Final = 1000.0  # largest acceleration, in and out
SMALLEST_M_S2: Final = 1e-3  # smallest threshold
THRESHOLD_M_S2: Final = 0.1  # default amplitude [m/s²] of the weakest vibration that is felt, up to 250 Hz
WEBER: Final = 0.2  # most of the error's level over that of the frame, on average, above the threshold

LARGEST_SCALE: Final = 127
LARGEST_RICE: Final = 15
LONGEST_BYTES: Final = 114  # of a payload: four bytes for each coefficient, of which hardly one is used
_CORNER_HZ: Final = 250.0

FREQUENCIES_HZ: Final[FloatArray] = np.arange(FRAME, dtype=np.float64) * (RATE_HZ / (2.0 * FRAME))
"""Frequency of each coefficient, shape (FRAME,)."""

_DCT: Final[FloatArray] = np.array(
    [
        [math.sqrt((2 if order else 1) / FRAME) * math.cos(math.pi / FRAME * order * (n + 0.5)) for n in range(FRAME)]
        for order in range(FRAME)
    ]
)


def felt_m_s2(threshold_m_s2: float, frequencies_hz: FloatArray) -> FloatArray:
    """Return the smallest amplitude [m/s²] that is felt at each frequency [Hz]; shape as the frequencies."""
    felt: FloatArray = threshold_m_s2 * np.maximum(1.0, frequencies_hz / _CORNER_HZ) ** 4
    return felt


class Quantised(NamedTuple):
    """A frame as whole numbers: `numbers` of steps of 2^(`scale` / 2), the last of which is not 0."""

    scale: int
    numbers: tuple[int, ...]


class VibrationCodec:
    """Encode and decode frames for a person whose threshold is `threshold_m_s2`; SettingsError if that is invalid."""

    def __init__(self, threshold_m_s2: float = THRESHOLD_M_S2) -> None:
        check_parameter("vibration threshold", threshold_m_s2, SMALLEST_M_S2, LARGEST_M_S2, "m/s²")
        felt = felt_m_s2(threshold_m_s2, FREQUENCIES_HZ)
        # A sinusoid of amplitude A has the energy A² · FRAME / 2, which its coefficients share.
        self._felt = math.sqrt(0.5 * FRAME) * felt
        self._finest = math.sqrt(12.0 / FRAME) * self._felt  # errors of FRAME such steps have the level 1, at the mean
        self._weights = _DCT / self._felt[:, None]

    def level(self, samples: Sequence[float] | FloatArray) -> float:
        """Return the level of a frame: its energy over that of the weakest vibration that is felt, as amplitudes."""
        weighted = self._weights @ np.asarray(samples, dtype=np.float64)
        return math.sqrt(float(weighted @ weighted))

    def steps(self, scale: int) -> FloatArray:
        """Return the quantiser's steps [m/s²] at a scale, shape (FRAME,); the error is at most half of them."""
        steps: FloatArray = self._finest * 2.0 ** (0.5 * scale)
        return steps

    def quantise(self, samples: Sequence[float], *, coarser: int = 0) -> Quantised | None:
        """Return a frame of accelerations [m/s²] as whole numbers, `coarser` by half octaves; None if it is not felt.

        Raise SampleError if there are not `FRAME`, or one is not within ±`LARGEST_M_S2`.
        """
        frame = np.asarray(samples, dtype=np.float64)
        if frame.shape != (FRAME,) or not float(np.abs(frame).max()) <= LARGEST_M_S2:
            raise SampleError(f"a frame of vibration has {FRAME} numbers within ±{LARGEST_M_S2:g} m/s²")
        weighted = self._weights @ frame
        level = math.sqrt(float(weighted @ weighted))
        if level < 1.0:
            return None
        scale = min(max(0, math.floor(2.0 * math.log2(WEBER * level))) + coarser, LARGEST_SCALE)
        step = math.sqrt(12.0 / FRAME) * 2.0 ** (0.5 * scale)
        numbers = np.rint(weighted / step).astype(np.int64).tolist()
        while numbers and not numbers[-1]:
            numbers.pop()
        return Quantised(scale, tuple(numbers)) if numbers else None

    def samples(self, quantised: Quantised) -> FloatArray:
        """Return the accelerations [m/s²] of a frame, shape (FRAME,), within ±`LARGEST_M_S2`."""
        count = len(quantised.numbers)
        coefficients = np.array(quantised.numbers, dtype=np.float64) * self.steps(quantised.scale)[:count]
        made: FloatArray = np.clip(coefficients @ _DCT[:count], -LARGEST_M_S2, LARGEST_M_S2)
        return made

    def encode(self, samples: Sequence[float], *, coarser: int = 0) -> bytes | None:
        """Return the payload of a frame; None if it is not felt. See `quantise`."""
        quantised = self.quantise(samples, coarser=coarser)
        return None if quantised is None else pack_frame(quantised)

    def decode(self, payload: bytes) -> FloatArray:
        """Return the accelerations [m/s²] of a payload, shape (FRAME,); raise PeerError if it is malformed."""
        return self.samples(unpack_frame(payload))


def pack_frame(quantised: Quantised) -> bytes:
    """Return the payload of a frame: 16 bits of scale, parameter and count, then Rice codes, then bits of 0.

    Numbers are folded (0, -1, 1, -2, … become 0, 1, 2, 3, …); a code is the number's upper bits as so many ones and a
    zero, then its `rice` lower bits (Rice and Plaunt 1971). The parameter is the one that takes the fewest bits.
    """
    scale, numbers = quantised
    folded = [2 * number if number >= 0 else -2 * number - 1 for number in numbers]
    rice = min(range(LARGEST_RICE + 1), key=lambda bits: sum(each >> bits for each in folded) + bits * len(folded))
    packed, length = scale << 9 | rice << 5 | len(folded), 16
    for each in folded:
        ones = each >> rice
        packed = (packed << ones + 1 | (1 << ones + 1) - 2) << rice | each & (1 << rice) - 1
        length += ones + 1 + rice
    return (packed << -length % 8).to_bytes((length + 7) // 8, "big")


def unpack_frame(payload: bytes) -> Quantised:
    """Return the whole numbers of a payload; raise PeerError if it is malformed."""
    bits = 8 * len(payload)
    if not 2 < len(payload) <= LONGEST_BYTES:
        raise PeerError(f"a frame of vibration of {len(payload)} bytes")
    packed = int.from_bytes(payload, "big")
    head = packed >> bits - 16
    scale, rice, count = head >> 9, head >> 5 & 15, head & 31
    if not 0 < count <= FRAME:
        raise PeerError(f"a frame of vibration with scale {scale} and {count} coefficients")
    left, numbers = bits - 16, []
    for _ in range(count):
        ones = 0
        while left and packed >> left - 1 & 1:
            ones, left = ones + 1, left - 1
        left -= 1 + rice
        if left < 0:
            raise PeerError("a frame of vibration that ends within a number")
        folded = ones << rice | packed >> left & (1 << rice) - 1
        numbers.append(-(folded + 1 >> 1) if folded & 1 else folded >> 1)
    if left >= 8 or packed & (1 << left) - 1 or not numbers[-1]:
        raise PeerError("a frame of vibration with more than its numbers")
    return Quantised(scale, tuple(numbers))
