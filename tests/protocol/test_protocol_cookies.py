"""Cookies prove an address without any state; token buckets bound how often it may then ask."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.handshake import MAC_BYTES, hello_mac, is_hello_mac
from hapticnet.protocol.hello_filter import GENERATION_US, Buckets, CookieJar
from hapticnet.protocol.messages import COOKIE_BYTES

SECOND = 1_000_000


HERE = b"('192.0.2.1', 5000)"


@pytest.fixture
def jar():
    return CookieJar(np.random.default_rng(1))


def test_a_cookie_is_accepted_from_its_address_with_its_nonce_alone(jar):
    cookie = jar.make(HERE, 7, 0)
    assert len(cookie) == COOKIE_BYTES
    assert jar.accepts(cookie, HERE, 7, 1)
    assert not jar.accepts(cookie, HERE, 8, 1)
    assert not jar.accepts(cookie, b"('192.0.2.1', 5001)", 7, 1)
    assert not jar.accepts(cookie, b"('192.0.2.2', 5000)", 7, 1)
    assert not jar.accepts(cookie, b"\x07" + HERE, 0, 1), "nonce and address do not run into each other"


@pytest.mark.parametrize("cookie", [b"", bytes(16), b"guessed a cookie"])
def test_no_other_cookie_is_accepted(jar, cookie):
    jar.make(HERE, 7, 0)
    assert not jar.accepts(cookie, HERE, 7, 1)


@pytest.mark.parametrize(
    ("now_us", "accepted"),
    [
        (GENERATION_US, True), (2 * GENERATION_US - 1, True), (2 * GENERATION_US, False), (10 * GENERATION_US, False),
        (-GENERATION_US, False),
    ],
)  # fmt: skip
def test_a_cookie_lives_for_the_generation_it_was_made_in_and_the_next_one(jar, now_us, accepted):
    start = 5 * GENERATION_US
    cookie = jar.make(HERE, 7, start + (30 * SECOND if accepted else 0))
    assert jar.accepts(cookie, HERE, 7, start + now_us) is accepted


def test_each_generation_and_each_slave_has_a_secret_of_its_own(jar):
    cookies = [jar.make(HERE, 7, generation * GENERATION_US) for generation in range(20)]
    cookies.append(CookieJar(np.random.default_rng(2)).make(HERE, 7, 0))
    assert len(set(cookies)) == 21


@pytest.mark.plain
def test_a_jar_keeps_nothing_for_an_address(jar):
    for nonce in range(1000):
        jar.make(f"address {nonce}".encode(), nonce, 0)
        jar.accepts(bytes(16), f"address {nonce}".encode(), nonce, 0)
    sizes = [len(value) for value in (jar._secret, jar._previous)]
    assert sizes == [32, 32]


@given(st.lists(st.integers(0, 300_000), min_size=50, max_size=200))
def test_a_bucket_lets_no_more_through_than_its_depth_and_rate(gaps):
    bucket, now_us, taken = TokenBucket(5.0, 8.0), 0, []
    for gap_us in gaps:
        now_us += gap_us
        if bucket.take(now_us):
            taken.append(now_us)
    for first in range(len(taken)):
        for last in range(first, len(taken)):
            assert last - first + 1 <= 8 + 5 * (taken[last] - taken[first]) / 1e6 + 1e-6


def test_a_bucket_is_full_at_first_and_fills_at_its_rate():
    bucket = TokenBucket(5.0, 8.0)
    assert [bucket.take(10**12) for _ in range(9)] == [True] * 8 + [False]
    assert [bucket.take(10**12 + 200_001 * step) for step in (1, 2, 3)] == [True] * 3
    assert not bucket.take(10**12 + 600_010)
    later = 10**12 + 3600 * SECOND
    assert [bucket.take(later) for _ in range(9)] == [True] * 8 + [False]


def test_a_clock_that_goes_back_fills_no_bucket_and_stops_none():
    bucket = TokenBucket(5.0, 1.0)
    assert bucket.take(10 * SECOND)
    assert not bucket.take(0)
    assert bucket.take(SECOND)


def test_keys_do_not_share_a_bucket_and_only_so_many_are_remembered():
    buckets = Buckets(5.0, 2.0, most_keys=100)
    assert [buckets.take("a", 0) for _ in range(3)] == [True, True, False]
    assert buckets.take("b", 0)
    for number in range(10_000):
        buckets.take(number, 0)
        buckets.take("a", 0)
    assert len(buckets._buckets) == 100
    assert not buckets.take("a", 0), "the one that keeps asking is remembered"


SLAVE = bytes(range(32))


uint32 = st.integers(0, 2**32 - 1)


@given(nonce=uint32, sequence=uint32, noise1=st.binary(max_size=200))
def test_the_code_is_what_the_document_says(nonce, sequence, noise1):
    key = hashlib.blake2s(b"hapticnet mac1" + SLAVE, digest_size=32).digest()
    said = nonce.to_bytes(4, "big") + sequence.to_bytes(4, "big") + noise1
    mac = hello_mac(SLAVE, nonce, sequence, noise1)
    assert mac == hashlib.blake2s(said, key=key, digest_size=16).digest()
    assert len(mac) == MAC_BYTES
    assert is_hello_mac(mac, SLAVE, nonce, sequence, noise1)


@pytest.mark.parametrize(
    ("slave", "nonce", "sequence", "noise1"),
    [(bytes(32), 1, 2, b"3"), (SLAVE, 2, 2, b"3"), (SLAVE, 1, 1, b"3"), (SLAVE, 1, 2, b"4"), (SLAVE, 1, 2, b"")],
)
def test_the_code_of_anything_else_is_wrong(slave, nonce, sequence, noise1):
    assert not is_hello_mac(hello_mac(SLAVE, 1, 2, b"3"), slave, nonce, sequence, noise1)


def test_every_flipped_bit_and_every_other_length_is_wrong():
    mac = hello_mac(SLAVE, 1, 2, b"3")
    for bit in range(8 * MAC_BYTES):
        changed = bytearray(mac)
        changed[bit // 8] ^= 1 << bit % 8
        assert not is_hello_mac(bytes(changed), SLAVE, 1, 2, b"3")
    assert not any(is_hello_mac(mac[:length], SLAVE, 1, 2, b"3") for length in range(MAC_BYTES))
    assert not is_hello_mac(mac + b"\0", SLAVE, 1, 2, b"3")
