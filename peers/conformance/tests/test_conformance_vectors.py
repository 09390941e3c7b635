"""The golden vectors of tests/vectors, as far as they can be reached through a peer's calls."""

import pytest

from conformance import golden
from conformance.script import first_difference
from conformance.session import felt_vectors


def differences(results):
    """Return how many results there are, and those that are not what they must be."""
    every = list(results)
    return len(every), {name: (outcome, wanted) for name, outcome, wanted in every if outcome != wanted}


def played(child, scripts):
    """Return name, difference and None of each script."""
    return ((name, first_difference(child, lines), None) for name, lines in scripts)


def has(child, feature, value):
    if not child.has(feature, value):
        pytest.skip(f"{child.peer.name} has no {value}")


def test_the_decoder_of_every_codec_is_exact_to_the_bit(child):
    has(child, "also", "decoder")
    count, wrong = differences(played(child, ((name, lines) for name, _, lines in golden.decoders())))
    assert wrong == {}
    assert count > 90


def test_what_a_master_applies_of_every_codecs_payloads_is_exact_to_the_bit(child, note):
    has(child, "roles", "master")
    known = ((name, lines) for name, codec, lines in felt_vectors() if child.has("codecs", codec))
    count, wrong = differences(played(child, known))
    assert wrong == {}
    note("vectors", count)


def test_a_master_says_what_the_vectors_say_to_the_byte(child, note):
    has(child, "roles", "master")
    count, lines = golden.conversation()
    assert first_difference(child, lines) is None
    note("vectors", count)


def test_a_master_says_the_sealed_hellos_to_the_byte_and_opens_their_welcome(child, note):
    has(child, "sealed", "master")
    count, lines = golden.sealed()
    assert first_difference(child, lines) is None
    note("vectors", count)


def test_a_master_refuses_the_datagrams_and_grants_that_it_must(child, note):
    has(child, "roles", "master")
    count, wrong = differences(played(child, golden.refused_by_masters()))
    assert wrong == {}
    note("vectors", count)


def test_a_master_acknowledges_as_the_traces_say(child, note):
    has(child, "roles", "master")
    count, wrong = differences(golden.traced(child))
    assert wrong == {}
    note("vectors", count)


@pytest.mark.parametrize(
    "talk", [golden.refused_requests, golden.refused_by_slaves, golden.answered_positions], ids=lambda f: f.__name__
)
def test_a_slave_refuses_and_answers_as_the_vectors_say(child, note, talk):
    has(child, "roles", "slave")
    count, wrong = differences(talk(child))
    assert wrong == {}
    note("vectors", count)
