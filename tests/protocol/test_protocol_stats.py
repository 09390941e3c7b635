import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.stats import Arrival, Distribution, Traffic
from hapticnet.protocol.wire import Kind


def test_every_byte_is_accounted_for_with_and_without_headers():
    traffic = Traffic()
    traffic.open_window(0, authentic=False)
    traffic.add(Kind.FORCE, 27)
    traffic.add_malformed(100)
    account = traffic.report()
    assert account["packets"] == 2
    assert account["payload_bytes"] == 127
    assert account["wire_bytes"] == 127 + 2 * 28
    assert account["by_kind"] == {"force": 1}
    assert account["malformed"] == 1


def test_losses_add_up_over_sessions():
    traffic = Traffic()
    traffic.open_window(0, authentic=False)
    assert traffic.arrive(3) is Arrival.NEW
    traffic.open_window(0, authentic=False)
    arrivals = [traffic.arrive(sequence) for sequence in (2, 2, 1)]
    assert arrivals == [Arrival.NEW, Arrival.DUPLICATE, Arrival.LATE]
    account = traffic.report()
    assert (account["lost"], account["late"], account["duplicate"]) == (2, 1, 1)


@given(st.lists(st.integers(0, 10**7), min_size=1, max_size=200), st.sampled_from([50, 99, 99.9]))
def test_percentiles_are_within_a_bucket_of_the_sorted_list(values, percent):
    distribution = Distribution()
    for value in values:
        distribution.add(value)
    exact = float(np.percentile(values, percent, method="inverted_cdf"))
    assert distribution.percentile(percent) == pytest.approx(exact, rel=0.0101, abs=1.02)
    assert distribution.report()["max_us"] == max(values)


def test_an_empty_distribution_says_that_nothing_was_measured():
    assert Distribution().report() == {"count": 0, "p50_us": None, "p99_us": None, "p99_9_us": None, "max_us": None}


def test_any_number_of_durations_fit_in_a_bounded_number_of_buckets():
    distribution = Distribution()
    for value in np.random.default_rng(0).integers(-5, 10**7, 20_000).tolist():
        distribution.add(value)
    assert len(distribution._counts) < 1700
