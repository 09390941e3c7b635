"""The code by which a HELLO shows that its sender knows the slave's public key."""

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.handshake import MAC_BYTES, hello_mac, is_hello_mac

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
