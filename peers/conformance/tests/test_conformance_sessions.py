"""Sessions in virtual time: the same bytes at the same times as hapticnet's own ends, and forces equal to the bit."""

import pytest

from conformance import damage
from conformance.scenarios import AGAINST_DELAY, MASTERS, SLAVES
from conformance.script import first_difference
from conformance.session import played

LIBM_ULPS = 4


@pytest.mark.parametrize("name", MASTERS)
def test_a_master_sends_the_same_bytes_and_applies_the_same_forces(child, name, require, script_of, note):
    require(MASTERS[name], "master")
    script = script_of(name, MASTERS[name])
    assert first_difference(child, script) is None
    note("ticks", sum(line.command.startswith("tick ") for line in script))


@pytest.mark.parametrize("name", AGAINST_DELAY)
def test_a_master_with_few_positions_or_announced_contact_agrees(child, name, require, script_of, note):
    require(AGAINST_DELAY[name], "master")
    script = script_of(name, AGAINST_DELAY[name])
    has_own = child.features.get("libm") == "own" and "stiffening" in name
    assert first_difference(child, script, LIBM_ULPS if has_own else 0) is None
    note("ticks", sum(line.command.startswith("tick ") for line in script))


@pytest.mark.parametrize("name", SLAVES)
def test_a_slave_gives_the_same_answers_and_forces(child, name, require, answers_of, note):
    require(SLAVES[name], "slave")
    session = played(SLAVES[name], child)
    assert session.answers() == answers_of(f"slave {name}", SLAVES[name])
    note("ticks", sum(line.command.startswith("tick ") for line in session.recorder.lines))


@pytest.mark.parametrize("name", damage.MASTERS)
def test_damaged_datagrams_change_nothing_at_a_master_that_they_do_not_change_at_hapticnets(
    child, name, require, script_of, note
):
    require(damage.MASTERS[name], "master")
    assert first_difference(child, script_of(name, damage.MASTERS[name])) is None
    note("malformed", damage.ROUNDS * damage.EACH_ROUND)


@pytest.mark.parametrize("name", damage.SLAVES)
def test_damaged_datagrams_are_answered_by_a_slave_as_by_hapticnets(child, name, require, answers_of, note):
    require(damage.SLAVES[name], "slave")
    assert played(damage.SLAVES[name], child).answers() == answers_of(f"slave {name}", damage.SLAVES[name])
    note("malformed", damage.ROUNDS * damage.EACH_ROUND)
