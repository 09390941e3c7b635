"""Numbers that nobody must guess come from the operating system."""

import secrets

from hapticnet.protocol.settings import random_bytes
from hapticnet.runtime.entropy import SystemEntropy


def test_numbers_come_from_the_operating_system_and_lie_in_their_range(monkeypatch):
    asked = []
    monkeypatch.setattr(secrets, "randbelow", lambda below: (asked.append(below), below - 1)[1])
    assert SystemEntropy().integers(1 << 16, 1 << 32) == (1 << 32) - 1
    assert asked == [(1 << 32) - (1 << 16)]


def test_no_two_tickets_are_alike():
    entropy = SystemEntropy()
    assert len({random_bytes(entropy, 16) for _ in range(1000)}) == 1000
