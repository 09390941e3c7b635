"""The chain that plays stimuli, in virtual time: meeting the finger, trials, pairs, and what is kept of them."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from conducted import GivenRig, WillingFront
from killed import settings_of

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.errors import FileError
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.procedures import Met
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.trace import TraceOperator
from hapticnet.perception import WeberLaw
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.session import in_force
from hapticnet.runtime.processes import Child
from hapticnet.runtime.runners import MasterRunner
from hapticnet.runtime.udp import HostPort, parse_host_port
from hapticnet_experiment import screens
from hapticnet_experiment.real_rig import RealRig
from hapticnet_experiment.rig import LIFTED_US, Fault, LiftWatch, Meet, Pair, VirtualRig
from hapticnet_experiment.rows import OrderRow
from hapticnet_experiment.session import conduct, open_session, record_trials, write_participant
from hapticnet_experiment.store import read_table
from hapticnet_experiment.tasks import LIMITS
from hapticnet_experiment.trial import Stimulus, scripted_hand

STIMULUS = Stimulus(
    number=4,
    breach_forces_n=(1.0, 1.75, 2.5),
    gap_m=0.02,
    codec="deadband",
    law=WeberLaw(weber_fraction=0.05, floor_n=0.025),
    rate_hz=1000.0,
    forward="perfect",
    feedback="perfect",
    seed=1,
    limit_s=10.0,
)


def push(contact_s, before_s=0.1):
    """Return a hand that pushes the first tissue only, at an even speed, after a time at rest."""

    def make_hand(_):
        speed_m_per_s = 0.01 / contact_s
        times_s = np.array([0.0, before_s, before_s + 0.036 / speed_m_per_s])
        return TraceOperator((times_s * 1e6).astype(np.int64), np.array([[0.0], [0.0], [0.036]]))

    return make_hand


def fingertip():
    device = SimulatedDevice(PlantSettings(), np.random.default_rng(1))
    return Fingertip(device, ForceControlSettings())


def rig_with(make_hand=scripted_hand):
    return VirtualRig(fingertip(), MasterSettings(), make_hand=make_hand)


def run(rig, *activities):
    return [asyncio.run(rig.run(activity)) for activity in activities]


def test_a_first_contact_that_is_fast_is_felt_once_the_platform_has_met_the_finger():
    (unmet,) = run(rig_with(push(0.145)), STIMULUS)
    assert unmet.measures.peaks_sensed_n[0] < 0.05
    met, played = run(rig_with(push(0.145)), Meet(), STIMULUS)
    assert isinstance(met, Met)
    assert met.sensed_n == pytest.approx(0.5, abs=0.1)
    assert played.measures.peaks_sensed_n[0] > 0.4 * played.measures.peaks_held_n[0]


def test_a_trial_tells_what_was_held_and_felt_in_each_tissue():
    _, played = run(rig_with(), Meet(), STIMULUS)
    measures = played.measures
    assert measures.peaks_held_n == pytest.approx(STIMULUS.breach_forces_n, rel=0.06)
    assert measures.peaks_sensed_n == pytest.approx(STIMULUS.breach_forces_n, rel=0.12)
    assert (measures.insertions, measures.penetrations) == (2, 6)
    assert 0.01 < measures.peak_speed_m_per_s < 0.1
    assert 0 < measures.force_packets < 1000
    assert measures.wire_bytes > 28 * measures.force_packets
    assert measures.undelivered(0.8) is None


@pytest.mark.parametrize("codec", ["raw", "deadband"])
def test_bytes_of_a_penetration_count_no_time_in_which_nothing_is_touched(codec):
    def measures(before_s):
        return run(rig_with(push(0.5, before_s)), Meet(), replace(STIMULUS, codec=codec))[1].measures

    short, long = measures(0.1), measures(5.0)
    assert (short.penetrations, long.penetrations) == (1, 1)
    assert long.penetration_packets == pytest.approx(short.penetration_packets, abs=3)
    assert long.penetration_bytes == pytest.approx(short.penetration_bytes, rel=0.1)
    if codec == "raw":  # each position in contact is answered
        assert long.wire_bytes > 3 * short.wire_bytes
        assert short.penetration_packets == pytest.approx(500, rel=0.1)


def test_a_push_that_the_device_cannot_follow_and_a_tissue_left_out_are_told():
    _, played = run(rig_with(push(0.145)), Meet(), STIMULUS)
    assert played.measures.undelivered(0.95).startswith("the device delivered")
    assert played.measures.undelivered(0.1) == "tissue 2 was not touched"


def test_a_trial_without_a_link_does_not_count():
    (outcome,) = run(rig_with(push(0.3)), replace(STIMULUS, feedback="loss=100%"))
    assert outcome.measures.force_packets == 0
    assert outcome.measures.undelivered(0.8) == "tissue 1 was not touched"


def test_both_forces_of_a_pair_are_delivered():
    rig = rig_with()
    pair = Pair(forces_n=(1.0, 1.1), stimulus_us=800_000, gap_us=300_000)
    _, presented = run(rig, Meet(), pair)
    assert presented.sensed_n == pytest.approx((1.0, 1.1), abs=0.06)
    assert presented.missed(0.1) is None
    assert replace(presented, sensed_n=(1.2, 1.1)).missed(0.1) == "1.000 N was felt as 1.200 N"


def test_an_activity_is_stopped_even_while_the_session_before_it_closes(monkeypatch):
    finish = MasterRunner.finish

    async def finish_later(runner, reason):
        await asyncio.sleep(0.1)
        await finish(runner, reason)

    hand = scripted_hand(STIMULUS)

    async def stop_each():
        async with RealRig(fingertip(), MasterSettings(), HostPort("127.0.0.1", 9), tell=print, hand=hand) as rig:
            for _ in range(3):
                activity = asyncio.ensure_future(rig.run(STIMULUS))
                await asyncio.sleep(0)
                rig.stop()
                # One that is not stopped ends with another fault after 10 s: no slave answers there.
                assert await asyncio.wait_for(activity, 30.0) == Fault("stopped", lost=False)

    monkeypatch.setattr(MasterRunner, "finish", finish_later)
    asyncio.run(stop_each())


def test_a_slave_with_another_scene_is_told_and_plays_no_trial():
    async def play(address):
        rig = RealRig(fingertip(), MasterSettings(), address, tell=print, hand=scripted_hand(STIMULUS))
        async with rig:
            return await rig.run(STIMULUS)

    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper"])
    try:
        outcome = asyncio.run(play(parse_host_port(slave.address())))
    finally:
        slave.end()
    assert "start it with --scene hapticnet_experiment.scene:NamedTissues" in outcome.reason


def test_a_finger_that_is_lifted_is_noticed_and_one_that_is_not_pressed_is_not():
    def lifted_us(target_n, sensed_n):
        watch = LiftWatch()
        seen = [now_us for now_us in range(0, 2_000_000, 1000) if watch.check(target_n, sensed_n(now_us), now_us)]
        return seen[0] if seen else None

    assert lifted_us(2.0, lambda _: 0.0) == LIFTED_US + 1000
    assert lifted_us(0.3, lambda _: 0.0) is None
    assert lifted_us(2.0, lambda now_us: 0.5 if now_us % 400_000 == 0 else 0.0) is None
    assert lifted_us(2.0, lambda now_us: 2.0 if now_us < 700_000 else 0.0) == 700_000 + LIFTED_US + 1000


def test_each_trial_is_recorded_beside_the_table_and_no_recording_is_overwritten(tmp_path):
    settings = settings_of(tmp_path, 3)
    row = OrderRow(event="repeated", participant="03", session=1, this_n=4, attempt=1, condition="1 JND")
    _, played = run(rig_with(push(0.3)), Meet(), STIMULUS)
    keep = record_trials(settings, {"device": "sim"})
    keep(row, played)
    keep(row, played)
    keep(row, Fault("nothing to keep"))
    folder = settings.folder / "recordings"
    assert sorted(file.name for file in folder.iterdir()) == ["trial-004-1-2.npz", "trial-004-1.npz"]
    session = read_session(folder / "trial-004-1.npz")
    assert len(session.tables["tick"]["t_us"]) == len(played.ticks["t_us"])
    assert session.about["trial"]["event"] == "repeated"
    ((_, settings),) = in_force(session.events)
    assert (settings["codec"], settings["channel_out"]) == (STIMULUS.codec, STIMULUS.forward)


def test_a_clock_that_is_set_back_changes_the_date_and_nothing_else(tmp_path):
    dates = iter(f"2026-11-{day:02}" for day in range(29, 0, -1))
    settings, rig = settings_of(tmp_path, 3), GivenRig()
    with open_session(settings, rig.now_us()) as (flow, store):
        asyncio.run(conduct(flow, rig, WillingFront(rig), store, date=lambda: next(dates)))
    rows = read_table(settings.table, OrderRow)
    assert rows[-1].event == "end"
    assert [row.date for row in rows] == sorted((row.date for row in rows), reverse=True)
    onsets = [row.onset_s for row in rows]
    assert onsets == sorted(onsets)
    assert all(row.duration_s >= 0.0 for row in rows)


def test_a_second_measurement_keeps_the_first(tmp_path):
    paths = []
    for session, key in ((1, screens.DIFFERENT), (2, screens.DIFFERENT), (2, screens.SAME)):
        settings, rig = replace(settings_of(tmp_path, 3), task=LIMITS, session=session), GivenRig()
        folder = settings.folder
        if folder.exists():
            folder.rename(folder.with_name("earlier"))
        front = WillingFront(rig)
        with open_session(settings, rig.now_us()) as (flow, store):
            asyncio.run(conduct(flow, rig, front, store, date=lambda: ""))
            if key == screens.SAME:
                flow.procedure.thresholds = [None if each is None else each + 0.1 for each in flow.procedure.thresholds]
            paths.append(write_participant(settings, flow)[0].name)
    assert paths == ["03.toml", "03.toml", "03-session-2.toml"]


def test_a_recording_that_cannot_be_written_ends_the_session_after_the_row_is_stored(tmp_path):
    settings, rig = settings_of(tmp_path, 3), GivenRig()
    settings.folder.mkdir(parents=True)
    (settings.folder / "recordings").write_text("a file where the folder should be")
    keep = record_trials(settings, {})
    with open_session(settings, rig.now_us()) as (flow, store), pytest.raises(FileError, match="recordings"):
        asyncio.run(conduct(flow, rig, WillingFront(rig), store, date=lambda: "", on_outcome=keep))
    assert [row.event for row in read_table(settings.table, OrderRow)] == [
        "begin", "consent", "meet", "started", "practice"
    ]  # fmt: skip
