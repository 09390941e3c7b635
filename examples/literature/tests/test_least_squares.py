"""The least-squares predictor: payloads of a few bits, states that are named, and the way back after a loss."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.streams import table_of_rows
from hapticnet.codec.values import SINGLE_BYTES
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet_literature.least_squares import (
    LeastSquares,
    LeastSquaresRule,
    Predictor,
    filtered_slope,
    receive,
    remember,
    start_predictor,
)
from hapticnet_literature.residuals import ABSOLUTE, RESIDUAL, Update

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)


def wave(samples: int, axes: int = 1, seed: int = 1) -> np.ndarray:
    """Return forces such as a hand makes: slow, smooth, with a little noise and a breach."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(samples)[:, np.newaxis] * 1e-3
    forces = 1.0 + np.sin(t_s * (5.0 + np.arange(axes))) + rng.normal(0.0, 0.004, (samples, axes))
    forces[samples // 2 :] -= 2.0
    return forces


def payloads(codec: LeastSquares, forces: np.ndarray) -> list[tuple[int, bytes]]:
    encoder = codec.encoder(forces.shape[1])
    made = ((1000 * index, encoder.encode(1000 * index, tuple(row))) for index, row in enumerate(forces.tolist()))
    return [(t_us, payload) for t_us, payload in made if payload is not None]


def is_absolute(payload: bytes) -> bool:
    return payload[0] >= ABSOLUTE


@pytest.mark.parametrize(("axes", "most"), [(1, 2), (2, 4), (3, 5)])
def test_most_payloads_are_two_bytes_for_one_axis_and_a_few_for_three(axes, most):
    made = [payload for _, payload in payloads(LeastSquares(law=LAW), wave(4000, axes))]
    residuals = [len(payload) for payload in made if not is_absolute(payload)]
    assert len(residuals) >= 0.8 * len(made)
    assert np.mean(residuals) <= most
    assert max(map(len, made)) <= 1 + 8 * axes


@pytest.mark.parametrize("every", [1, 4, 16])
def test_at_least_every_so_many_payloads_one_is_absolute(every):
    made = [is_absolute(payload) for _, payload in payloads(LeastSquares(law=LAW, absolute_every=every), wave(4000))]
    runs = "".join("A" if absolute else "r" for absolute in made).split("A")
    assert made[0]
    assert max(map(len, runs)) == every - 1


def test_every_payload_names_the_update_it_makes_or_builds_on():
    made = [payload for _, payload in payloads(LeastSquares(law=LAW), wave(40_000))]
    assert len(made) > 300
    for number, payload in enumerate(made):
        assert payload[0] == (ABSOLUTE + number % 128 if is_absolute(payload) else (number - 1) % 128)


@given(lost=st.sets(st.integers(0, 60), min_size=1), axes=st.integers(1, 3), updates=st.sampled_from([2, 4]))
def test_a_decoder_in_another_state_refuses_until_the_next_absolute_payload(lost, axes, updates):
    codec = LeastSquares(law=LAW, absolute_every=7, updates=updates)
    decoder, twin = codec.decoder(axes), codec.decoder(axes)
    in_step = True
    for number, (t_us, payload) in enumerate(payloads(codec, wave(1500, axes))):
        twin.decode(t_us, payload)
        if number in lost:
            in_step = False
            continue
        in_step = in_step or is_absolute(payload)
        if in_step:
            decoder.decode(t_us, payload)
            assert decoder.reconstruct(t_us + 500) == twin.reconstruct(t_us + 500)
        else:
            before = decoder.reconstruct(t_us)
            with pytest.raises(PeerError, match=r"builds on update \d+; the last one here is"):
                decoder.decode(t_us, payload)
            assert decoder.reconstruct(t_us) == before


def test_a_payload_that_comes_twice_or_late_is_refused():
    codec = LeastSquares(law=LAW)
    decoder = codec.decoder(1)
    made = payloads(codec, wave(1000))
    residual = next(number for number, (_, payload) in enumerate(made) if not is_absolute(payload))
    for t_us, payload in made[: residual + 1]:
        decoder.decode(t_us, payload)
    with pytest.raises(PeerError, match="builds on update"):
        decoder.decode(*made[residual])


def test_a_loss_is_repaired_by_the_one_payload_that_follows_a_refresh_without_losing_the_slope():
    codec = LeastSquares(law=LAW)
    encoder, decoder, twin = codec.encoder(1), codec.decoder(1), codec.decoder(1)
    sent = 0
    for index in range(1000):
        if index == 700:
            encoder.refresh()
        payload = encoder.encode(1000 * index, (2e-3 * index,))
        if payload is None:
            continue
        sent += 1
        twin.decode(1000 * index, payload)
        if not 100 <= index < 700:
            decoder.decode(1000 * index, payload)
    assert sent <= 25  # a ramp needs an update per horizon, with a refresh or without
    assert decoder.reconstruct(1_000_000) == twin.reconstruct(1_000_000)


def test_what_no_short_code_can_say_is_said_in_full():
    codec = LeastSquares(law=LAW)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    for index, force_n in enumerate((1.0, 1e5, -1e15, 3.0, 1e6)):
        payload = encoder.encode(1000 * index, (force_n,))
        assert payload is not None
        assert is_absolute(payload)
        assert len(payload) == 9
        decoder.decode(1000 * index, payload)
        assert abs(decoder.reconstruct(1000 * index)[0] - force_n) <= LAW.threshold_n(abs(force_n))
    tiny = LeastSquares(law=WeberLaw(weber_fraction=0.0, floor_n=1e-12, multiplier=1e-12))
    made = payloads(tiny, np.array([[0.0], [1e15], [-1e15]]))
    assert [is_absolute(payload) for _, payload in made] == [True] * 3, "more steps than can be coded"


def test_residuals_that_no_encoder_makes_are_refused():
    codec = LeastSquares(law=WeberLaw(weber_fraction=1.0, floor_n=0.0))
    decoder = codec.decoder(1)
    ((t_us, first),) = payloads(codec, np.array([[1e15]]))
    decoder.decode(t_us, first)
    for payload, wrong in (
        (b"", "0 bytes"),
        (b"\0", "end within"),
        (b"\0\xff", "end within"),
        (b"\0\0\0", "hold more"),
        (b"\0\0\0\0\0\0", "residual of 5 bytes"),
        (b"\1\0", "builds on update 1; the last one here is 0"),
        (b"\0\xf8", "beyond ±1e"),  # eight halves of a threshold that is as large as the value
        (b"\x80", "payload of 0 bytes"),
        (b"\x80" + b"\0" * 7, "payload of"),
    ):
        with pytest.raises(PeerError, match=wrong):
            decoder.decode(t_us, payload)
        assert decoder.reconstruct(t_us) == (999999986991104.0,)


def received(rule, predictor: Predictor, number: int, steps: float) -> Predictor:
    """Return the predictor after a residual of one axis, a millisecond after the one before."""
    update = Update(RESIDUAL, number - 1, (steps,), (steps,), predictor.rice.parameter)
    return receive(rule, predictor, 1000 * number, update)


def started(**parameters: float) -> tuple[LeastSquaresRule, Predictor]:
    """Return a rule, and its predictor after an absolute update of 1 N."""
    rule = LeastSquares(law=LAW, **parameters).rule(1, table_of_rows)
    return rule, receive(rule, start_predictor(rule, 1), 0, Update(SINGLE_BYTES, 0, (1.0,), (0.0,), 0))


def test_the_code_follows_the_residuals_until_the_next_line():
    rule, predictor = started()
    first = predictor.rice
    for number in range(1, 9):
        predictor = received(rule, predictor, number, 40.0)
    assert predictor.rice.parameter > first.parameter
    predictor = receive(rule, predictor, 9000, Update(SINGLE_BYTES, 9, (1.0,), (0.0,), 0))
    assert predictor.rice == first


@pytest.mark.parametrize("step_fraction", [0.01, 0.1, 0.5])
def test_finer_steps_start_with_longer_codes(step_fraction):
    made = [payload for _, payload in payloads(LeastSquares(law=LAW, step_fraction=step_fraction), wave(4000))]
    residuals = [len(payload) for payload in made if not is_absolute(payload)]
    assert len(residuals) >= 0.8 * len(made)
    assert np.mean(residuals) <= 2.0 + 0.7 * math.log10(0.5 / step_fraction)


def remembered(rule: LeastSquaresRule, *values: float, known: int = 0, alone: bool = False) -> int:
    """Write updates of one axis, a millisecond apart, behind those that are known."""
    for value in values:
        known = remember(rule, known, 1000 * known, (value,), alone)
    return known


def test_the_slope_leaves_out_an_outlier_and_what_was_before_an_impact():
    rule, _ = started(updates=4)
    known = remembered(rule, 1.0, 1.1, 1.0, 1.0)
    assert filtered_slope(rule, known, (1.0,)) == (0.0,)
    known = remembered(rule, 3.0, known=known, alone=True)
    assert filtered_slope(rule, known, (3.0,)) == (0.0,)
    assert remember(rule, known, 5000, (3.1,), False) == 2
    assert filtered_slope(rule, 2, (3.1,)) == pytest.approx((100.0,))


@pytest.mark.parametrize(("steps", "known"), [(6.0, 2), (-6.0, 2), (7.0, 1), (80.0, 1)])
def test_a_residual_of_more_than_three_thresholds_is_an_impact_and_starts_the_line_again(steps, known):
    rule, predictor = started(step_fraction=0.5)
    predictor = received(rule, predictor, 1, steps)
    assert predictor.known == known
    assert (predictor.line.rate == (0.0,)) == (known == 1)


def test_a_full_table_forgets_the_oldest_update():
    rule, _ = started(updates=3)
    assert remembered(rule, 9.0, 1.0, 2.0) == 3
    assert remember(rule, 3, 3000, (3.0,), False) == 3
    assert [row[0] for row in rule.values] == [1.0, 2.0, 3.0]


def test_a_median_of_three_takes_out_a_single_outlier_but_neither_end():
    rule = LeastSquares(updates=4).rule(2, table_of_rows)
    samples = [(0.0, 5.0), (9.0, 1.0), (2.0, 2.0), (3.0, 3.0)]
    for k, sample in enumerate(samples):
        remember(rule, k, k, sample, False)
    filtered_slope(rule, 4, samples[-1])
    assert [list(each) for each in rule.filtered] == [[0.0, 5.0], [2.0, 2.0], [3.0, 2.0], [3.0, 3.0]]
    assert filtered_slope(rule, 2, samples[1]) == pytest.approx((9e6, -4e6))
