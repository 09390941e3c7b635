"""A master that asks for another codec or JND while its session runs."""

import pytest

from hapticnet.errors import SettingsError
from hapticnet.node.events import CHANGES_KEPT, SettingsInForce
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import ChangeRefused, Connected, LinkStale
from hapticnet.protocol.wire import unpack
from tests.peers import Still, events_of

SECOND = 1_000_000
CHANGES = {
    "codec": {"codec": "motion-predictive"},
    "JND": {"law": WeberLaw(multiplier=4.0)},
    "every sample": {"codec": "raw"},
}


@pytest.mark.parametrize("round_trip_ms", [0, 40, 220, 500, 960])
@pytest.mark.parametrize("change", CHANGES)
def test_a_change_in_contact_is_not_felt(loopback, change, round_trip_ms, sealed):
    delay = f"delay={round_trip_ms / 2}ms"
    link = loopback(1, sealed=sealed, forward=delay, feedback=delay, settings=MasterSettings(record=True))
    link.master._operator = Still()
    link.run(4 * SECOND)
    link.master.change(**CHANGES[change])
    link.run(6 * SECOND)
    assert link.master.connections == 2
    true_n = link.slave.contexts[0].scene.force_n
    assert true_n > 1.0
    held_n = link.master.recording.table()["held_n"][4000:]
    assert abs(held_n - true_n).max() <= link.master.codec.law.threshold_n(true_n) * 1.01
    kinds = [type(event) for event in events_of(link.master)]
    assert kinds.count(LinkStale) == (round_trip_ms > 200), "only before the very first force"


@pytest.mark.plain
def test_a_change_whose_first_force_is_lost_is_not_felt(loopback):
    link = loopback(1, forward="delay=110ms", feedback="delay=110ms", settings=MasterSettings(record=True))
    link.master._operator = Still()
    link.run(4 * SECOND)
    link.master.change(codec="raw")
    lost = []

    def receive(data, now_us):
        frame = unpack(data)
        if frame.session == link.master.session.number and link.master.connections == 2 and len(lost) < 20:
            lost.append(data)  # the first forces of the new session
        else:
            MasterNode.receive_datagram(link.master, data, now_us)

    link.master.receive_datagram = receive
    link.run(6 * SECOND)
    assert len(lost) == 20
    true_n = link.slave.contexts[0].scene.force_n
    assert abs(link.master.recording.table()["held_n"][4000:] - true_n).max() <= 0.1


@pytest.mark.plain
def test_forces_of_the_session_before_count_only_until_the_first_of_the_new_one(loopback):
    link = loopback(1, forward="delay=50ms", feedback="delay=50ms", settings=MasterSettings(record=True))
    link.master._operator = Still()
    link.run(2 * SECOND)
    old = []
    receive = link.master.receive_datagram
    link.master.receive_datagram = lambda data, now_us: (old.append(data), receive(data, now_us))
    link.master.change(codec="raw")
    link.run(SECOND)
    number = unpack(old[0]).session
    assert number != unpack(old[-1]).session
    copies = [data for data in old if unpack(data).session == number]
    before = link.master.report()["received"]["stray"]
    held_n = link.master.held_force_n(link.now_us)
    for data in copies:
        receive(data, link.now_us)
    assert link.master.report()["received"]["stray"] == before + len(copies)
    assert link.master.held_force_n(link.now_us) == held_n


def test_the_scene_stays_pierced_and_the_force_follows_the_new_law(loopback, sealed):
    link = loopback(1, sealed=sealed, feedback="delay=5ms", forward="delay=5ms")
    link.run(3 * SECOND)
    (before,) = link.slave.contexts
    assert before.scene.breaches > 0
    events_of(link.master)
    link.master.change(codec="level-crossing", law=WeberLaw(multiplier=2.0))
    link.run(SECOND)
    (after,) = link.slave.contexts
    assert after.scene is before.scene
    assert after is not before
    assert (after.codec.name, after.codec.law.multiplier) == ("level-crossing", 2.0)
    assert [type(event) for event in events_of(link.master)] == [Connected, SettingsInForce]
    assert link.master.report()["codec"] == "level-crossing"
    link.run(SECOND)
    error_n = abs(link.master.held_force_n(link.now_us)[0] - after.scene.force_n)
    assert error_n <= after.codec.law.threshold_n(after.scene.force_n) + 1.0, "delay alone may add to the threshold"


def test_what_is_not_given_stays(loopback):
    link = loopback(1, settings=MasterSettings(codec="level-crossing", parameters={"hysteresis": 0.5}))
    link.run(SECOND)
    link.master.change(law=WeberLaw(multiplier=4.0))
    link.run(SECOND)
    (context,) = link.slave.contexts
    assert context.codec.hysteresis == 0.5
    assert context.codec.law.multiplier == 4.0


@pytest.mark.plain
def test_a_change_that_the_slave_refuses_leaves_the_session_as_it_was(loopback, monkeypatch):
    link = loopback(1)
    link.run(SECOND)
    (before,) = link.slave.contexts
    events_of(link.master)
    monkeypatch.setattr("hapticnet.node.admission.all_codecs", dict)
    monkeypatch.setattr(
        "hapticnet.node.admission.make_codec", lambda *_: (_ for _ in ()).throw(SettingsError("not served here"))
    )
    link.master.change(codec="raw")
    link.run(SECOND)
    (refused,) = events_of(link.master)
    assert isinstance(refused, ChangeRefused)
    assert (refused.code, refused.reason) == (Code.CODEC, "not served here")
    assert link.slave.contexts == (before,)
    assert link.master.codec.name == "deadband"
    assert link.master.session.streaming


def test_an_unknown_codec_is_refused_before_anything_is_asked(loopback):
    link = loopback(1)
    link.run(SECOND)
    events_of(link.master)
    with pytest.raises(SettingsError, match="morse"):
        link.master.change(codec="morse")
    link.run(SECOND)
    assert events_of(link.master) == []
    assert link.master.codec.name == "deadband"


def test_a_change_before_there_is_a_session_is_what_is_asked_for(loopback):
    link = loopback(1)
    link.master.change(codec="raw")
    link.run(SECOND)
    assert link.slave.contexts[0].codec.name == "raw"


def test_a_change_survives_a_lost_session(loopback):
    link = loopback(1, session=SessionSettings(keep_us=1_000_000))
    link.run(SECOND)
    link.master.change(codec="raw")
    link.slave.close("restarting", link.now_us)
    link.run(2 * SECOND)
    assert link.slave.contexts[-1].codec.name == "raw"
    assert link.master.session.streaming


WAY_US = 60_000


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
    kinds = [type(event) for event in events_of(link.master)]
    assert kinds == [Connected, SettingsInForce, Connected, SettingsInForce]
    assert [each["t_s"] for each in link.master.report()["in_force"]] == [0.0, (changed_us - begun_us) / 1e6]


def test_emulated_networks_are_told_when_they_change_and_only_then(loopback):
    link = loopback(1)
    link.master.emulate("delay=5ms", None)
    assert events_of(link.master) == [], "nothing is in force before there is a session"
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
