"""Recordings, laws and times that every codec must bear, and a streaming pair run over them."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec.base import Codec, Encoding
from hapticnet.perception import WeberLaw
from hapticnet.vectors import magnitude

# Forces of every size there is, exact zeros, sign changes and repeats included.
anything = st.floats(-1e15, 1e15, allow_nan=False)
haptic = st.floats(-10.0, 10.0)
recordings = st.integers(1, 3).flatmap(
    lambda axes: npst.arrays(
        np.float64, st.tuples(st.integers(0, 60), st.just(axes)), elements=st.one_of(haptic, anything, st.just(0.0))
    )
)
laws = st.builds(
    WeberLaw,
    weber_fraction=st.one_of(st.just(0.0), st.floats(1e-12, 1.0)),
    floor_n=st.one_of(st.just(0.0), st.floats(1e-12, 2.0)),
    multiplier=st.sampled_from([0.0, 0.3, 1.0, 2.0, 4.0]),
)
steps = st.sampled_from([0.0, 1e-12, 1e-6, 0.001, 0.03, 1.0])


@st.composite
def timed(draw):
    """Return times with repeats and gaps, a recording, and positions of the same shape, slow and fast."""
    stimuli = draw(recordings)
    gap_us = st.one_of(st.just(1000), st.just(0), st.integers(0, 30_000), st.integers(0, 2**55))
    gaps = draw(st.lists(gap_us, min_size=len(stimuli), max_size=len(stimuli)))
    positions = draw(npst.arrays(np.float64, stimuli.shape, elements=st.one_of(st.floats(-0.1, 0.1), anything)))
    return np.cumsum(np.array(gaps, dtype=np.int64)), stimuli, positions


def stream(codec: Codec, stimuli: np.ndarray, t_us: np.ndarray | None = None, apart_us: int = 0) -> Encoding:
    """Run the streaming pair over a recording; the clock of the decoder is ahead by `apart_us`."""
    axes = stimuli.shape[1]
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    sent, sizes, decoded = [], [], []
    for index, (at_us, row) in enumerate(
        zip(range(len(stimuli)) if t_us is None else t_us.tolist(), stimuli, strict=True)
    ):
        payload = encoder.encode(at_us, tuple(row.tolist()))
        if payload is not None:
            decoder.decode(at_us + apart_us, payload)
            sent.append(index)
            sizes.append(len(payload))
        decoded.append(decoder.reconstruct(at_us + apart_us))
    return Encoding(np.array(sent, np.int64), np.array(decoded).reshape(-1, axes), np.array(sizes, np.int64))


def assert_same(one: Encoding, other: Encoding) -> None:
    assert one.sent.tolist() == other.sent.tolist()
    assert one.payload_bytes.tolist() == other.payload_bytes.tolist()
    assert one.decoded.tobytes() == other.decoded.tobytes()


def distances(stimuli: np.ndarray, decoded: np.ndarray) -> list[float]:
    """Return how far the held stimulus is from the true one at every sample."""
    pairs = zip(stimuli.tolist(), decoded.tolist(), strict=True)
    return [magnitude(tuple(x - held for x, held in zip(*pair, strict=True))) for pair in pairs]


def assert_within_threshold(law: WeberLaw, stimuli: np.ndarray, decoded: np.ndarray) -> None:
    for distance, held in zip(distances(stimuli, decoded), decoded.tolist(), strict=True):
        assert distance <= law.threshold_n(magnitude(tuple(held)))


def wandering(samples: int, *, seed: int, axes: int = 1) -> np.ndarray:
    """Return a force that wanders between 0 and 4 N as a hand's does, with a little noise."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(samples)[:, np.newaxis] / 1000.0
    phases = rng.uniform(0.0, 6.0, axes)
    return 2.0 + np.sin(3.0 * seconds + phases) + np.sin(7.1 * seconds + phases) + rng.normal(0, 0.003, (samples, axes))
