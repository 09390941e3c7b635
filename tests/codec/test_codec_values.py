"""How a stimulus becomes bytes, and what is refused on the way back."""

import math
import struct

import pytest
from codec_cases import anything, haptic, laws, steps
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.schemes.raw import Raw
from hapticnet.codec.values import ValueForm, ValueRule, law_numbers, rounded
from hapticnet.errors import PeerError, SampleError
from hapticnet.perception import WeberLaw
from hapticnet.vectors import distance, magnitude

stimuli = st.lists(st.one_of(haptic, anything), min_size=1, max_size=3).map(tuple)


def packed(stimulus, law, step_n):
    """Return the payload of a stimulus, what the receiver makes of it, and the threshold around that."""
    form, reference, threshold = rounded(ValueRule(*law_numbers(law), step_n), stimulus)
    return ValueForm(len(stimulus), step_n=step_n).pack((form, reference)), reference, threshold


@given(stimuli, laws, steps)
def test_the_receiver_gets_the_reference_to_the_bit_and_it_is_within_the_threshold(stimulus, law, step_n):
    payload, reference, threshold = packed(stimulus, law, step_n)
    assert ValueForm(len(stimulus), step_n=step_n).unpack(payload) == (len(payload) // len(stimulus), reference)
    assert threshold == law.threshold_n(magnitude(reference))
    assert distance(stimulus, reference) <= threshold


@given(stimuli, laws)
def test_a_longer_payload_is_taken_only_where_the_shorter_one_is_not_true_enough(stimulus, law):
    axes = len(stimulus)
    payload, *_ = packed(stimulus, law, 0.001)
    counts = [round(x / 0.001) for x in stimulus]
    counted = tuple(count * 0.001 for count in counts)
    counts_do = max(map(abs, counts)) <= 32_767 and distance(stimulus, counted) <= law.threshold_n(magnitude(counted))
    single = tuple(struct.unpack(">f", struct.pack(">f", x))[0] for x in stimulus)
    single_does = distance(stimulus, single) <= law.threshold_n(magnitude(single))
    assert len(payload) == axes * (2 if counts_do else 4 if single_does else 8)


@given(st.floats(-32.767, 32.767), st.sampled_from([0.001, 0.002, 0.5]))
def test_a_raw_count_is_half_a_step_away_at_most(force_n, step_n):
    codec = Raw(step_n=step_n, law=WeberLaw(multiplier=0.0))
    payload = codec.encoder(1).encode(0, (force_n,))
    decoder = codec.decoder(1)
    decoder.decode(0, payload)
    assert len(payload) == 2
    assert abs(decoder.reconstruct(0)[0] - force_n) <= 0.5 * step_n * (1 + 1e-9)


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"", "payload of 0 bytes; 1 axes take 2 or 4 or 8"),
        (b"\0" * 6, "payload of 6 bytes"),
        (struct.pack(">h", -32_768), "payload counts -32768 steps; the smallest count is -32767"),
        (struct.pack(">f", math.nan), "payload holds nan"),
        (struct.pack(">f", 2e15), "payload holds 19999"),
        (struct.pack(">d", -math.inf), "payload holds -inf"),
    ],
)
def test_an_invalid_payload_is_refused_and_the_held_stimulus_stays(payload, message):
    decoder = Deadband(step_n=0.001).decoder(1)
    decoder.decode(0, struct.pack(">h", 1500))
    with pytest.raises(PeerError, match=message):
        decoder.decode(1, payload)
    assert decoder.reconstruct(2) == (1500 * 0.001,)


def test_a_form_that_was_not_agreed_on_or_of_a_wrong_number_of_axes_is_refused():
    with pytest.raises(PeerError, match="payload of 2 bytes; 1 axes take 4 or 8"):
        ValueForm(1).unpack(b"\0\0")
    with pytest.raises(PeerError, match=r"payload of 8 bytes; 1 axes take 4$"):
        Raw().decoder(1).decode(0, bytes(8))
    for axes in (0, 4):
        with pytest.raises(SampleError, match="1 to 3 are supported"):
            ValueForm(axes)
