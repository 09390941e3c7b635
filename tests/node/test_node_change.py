"""A master that asks for another codec or JND while its session runs."""

import pytest

from hapticnet.errors import SettingsError
from hapticnet.node.master_settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.protocol.events import ChangeRefused, Connected
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings

SECOND = 1_000_000


def events(node):
    return list(iter(node.next_event, None))


def test_the_scene_stays_pierced_and_the_force_follows_the_new_law(loopback, sealed):
    link = loopback(1, sealed=sealed, feedback="delay=5ms", forward="delay=5ms")
    link.run(3 * SECOND)
    (before,) = link.slave.stations
    assert before.scene.breaches > 0
    events(link.master)
    link.master.change(codec="level-crossing", law=WeberLaw(multiplier=2.0))
    link.run(SECOND)
    (after,) = link.slave.stations
    assert after.scene is before.scene
    assert after is not before
    assert (after.codec.name, after.codec.law.multiplier) == ("level-crossing", 2.0)
    assert [type(event) for event in events(link.master)] == [Connected]
    assert link.master.report()["codec"] == "level-crossing"
    link.run(SECOND)
    error_n = abs(link.master.held_force_n(link.now_us)[0] - after.scene.force_n)
    assert error_n <= after.codec.law.threshold_n(after.scene.force_n) + 1.0, "delay alone may add to the threshold"


def test_what_is_not_given_stays(loopback):
    link = loopback(1, settings=MasterSettings(codec="level-crossing", parameters={"hysteresis": 0.5}))
    link.run(SECOND)
    link.master.change(law=WeberLaw(multiplier=4.0))
    link.run(SECOND)
    (station,) = link.slave.stations
    assert station.codec.hysteresis == 0.5
    assert station.codec.law.multiplier == 4.0


def test_positions_and_forces_go_on_while_the_change_is_asked_for(loopback):
    link = loopback(1, feedback="delay=100ms", forward="delay=100ms")
    link.run(2 * SECOND)
    packets = link.master.session.sent.packets
    link.master.change(codec="raw")
    link.run(150_000)
    assert link.master.session.sent.packets > packets + 140
    assert link.master.session.streaming
    link.run(SECOND)
    assert link.slave.stations[-1].codec.name == "raw"


def test_a_change_that_the_slave_refuses_leaves_the_session_as_it_was(loopback, monkeypatch):
    link = loopback(1)
    link.run(SECOND)
    (before,) = link.slave.stations
    events(link.master)
    monkeypatch.setattr("hapticnet.node.admission.all_codecs", dict)
    monkeypatch.setattr(
        "hapticnet.node.admission.make_codec", lambda *_: (_ for _ in ()).throw(SettingsError("not served here"))
    )
    link.master.change(codec="raw")
    link.run(SECOND)
    (refused,) = events(link.master)
    assert isinstance(refused, ChangeRefused)
    assert (refused.code, refused.reason) == (Code.CODEC, "not served here")
    assert link.slave.stations == (before,)
    assert link.master.codec.name == "deadband"
    assert link.master.session.streaming


def test_an_unknown_codec_is_refused_before_anything_is_asked(loopback):
    link = loopback(1)
    link.run(SECOND)
    events(link.master)
    with pytest.raises(SettingsError, match="morse"):
        link.master.change(codec="morse")
    link.run(SECOND)
    assert events(link.master) == []
    assert link.master.codec.name == "deadband"


def test_a_change_before_there_is_a_session_is_what_is_asked_for(loopback):
    link = loopback(1)
    link.master.change(codec="raw")
    link.run(SECOND)
    assert link.slave.stations[0].codec.name == "raw"


def test_a_change_survives_a_lost_session(loopback):
    link = loopback(1, session=SessionSettings(keep_us=1_000_000))
    link.run(SECOND)
    link.master.change(codec="raw")
    link.slave.close("restarting", link.now_us)
    link.run(2 * SECOND)
    assert link.slave.stations[-1].codec.name == "raw"
    assert link.master.session.streaming
