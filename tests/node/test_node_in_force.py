"""What is in force at a master is known for every moment: codec, JND, rate and emulated networks."""

import pytest

from hapticnet.control.hold import PassivityController
from hapticnet.node.events import CHANGES_KEPT, SettingsInForce
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.protocol.states import Connected

SECOND = 1_000_000
WAY_US = 60_000


def events(node):
    return list(iter(node.next_event, None))


def test_a_change_is_in_force_from_the_first_force_of_the_new_session(loopback):
    link = loopback(
        1, forward="delay=60ms", feedback="delay=60ms", settings=MasterSettings(codec="deadband", rate_hz=500.0)
    )
    link.run(2 * SECOND)
    link.master.change(codec="level-crossing", law=WeberLaw(multiplier=2.0), parameters={"hysteresis": 0.5})
    link.run(SECOND)
    ((begun_us, first), (changed_us, second)) = link.master.in_force.history
    assert (first.codec, first.multiplier, first.rate_hz) == ("deadband", 1.0, 500.0)
    assert (second.codec, second.multiplier, second.parameters["hysteresis"]) == ("level-crossing", 2.0, 0.5)
    assert first.scene == second.scene == link.master.scene_name
    # Request, cookie and grant take two round trips; then the first position must be answered.
    assert changed_us >= 2 * SECOND + 3 * 2 * WAY_US
    kinds = [type(event) for event in events(link.master)]
    assert kinds == [Connected, SettingsInForce, Connected, SettingsInForce]
    assert [each["t_s"] for each in link.master.report()["in_force"]] == [0.0, (changed_us - begun_us) / 1e6]


def test_the_force_is_that_of_the_settings_in_force(loopback):
    """With every sample sent, the decoded force changes in nearly every tick of a moving hand; in a deadband it does
    not."""
    link = loopback(
        1, forward="delay=60ms", feedback="delay=60ms", settings=MasterSettings(codec="raw", record=True), insertions=9
    )
    link.run(4 * SECOND)
    link.master.change(codec="deadband", law=WeberLaw(multiplier=8.0))
    link.run(4 * SECOND)
    (_, (changed_us, _)) = link.master.in_force.history
    rows = link.master.recording.table()
    moves = abs(rows["received_n"][1:] - rows["received_n"][:-1]) > 0.0
    t_us = rows["t_us"][1:]
    before, after = moves[t_us < changed_us].mean(), moves[t_us >= changed_us].mean()
    assert before > 5 * after


def test_emulated_networks_are_told_when_they_change_and_only_then(loopback):
    link = loopback(1)
    link.master.emulate("delay=5ms", None)
    assert events(link.master) == [], "nothing is in force before there is a session"
    link.run(SECOND)
    link.master.emulate("delay=5ms", None)
    link.run(SECOND)
    link.master.emulate("delay=9ms", "loss=1%")
    link.run(SECOND)
    channels = [(each.channel_out, each.channel_in) for _, each in link.master.in_force.history]
    assert channels == [("delay=5ms", None), ("delay=9ms", "loss=1%")]
    assert link.master.in_force.history[1][0] == pytest.approx(2 * SECOND, abs=2000)


def test_the_same_settings_in_another_session_are_nothing_new(loopback):
    link = loopback(1)
    link.run(SECOND)
    link.master.change(law=link.master.codec.law)
    link.run(SECOND)
    assert link.master.connections == 2
    assert len(link.master.in_force.history) == 1


def test_what_is_kept_is_bounded(loopback):
    link = loopback(1)
    link.run(SECOND)
    for number in range(CHANGES_KEPT + 50):
        link.master.emulate(f"delay={number + 1}us", None)
    assert len(link.master.report()["in_force"]) == CHANGES_KEPT


@pytest.mark.plain
def test_passivity_control_uses_the_floor_in_force(loopback, monkeypatch):
    made = []
    limit = PassivityController.limit
    monkeypatch.setattr(
        PassivityController, "limit", lambda port, *arguments: made.append(port) or limit(port, *arguments)
    )
    link = loopback(1, settings=MasterSettings(passive=True))
    link.run(SECOND)
    link.master.change(law=WeberLaw(floor_n=0.2))
    link.run(SECOND)
    assert made[-1].contact_n == 0.2
