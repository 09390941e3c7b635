"""Recordings on a page: figures at any time, blocks of rows, and the page that plays them."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from hapticnet.errors import FileError
from hapticnet.measure.metrics import error_report
from hapticnet.node.recording import DATAGRAM_COLUMNS, master_columns, slave_columns
from hapticnet.parts import parse_parts
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind
from hapticnet.recordings.loading import Recording
from hapticnet.recordings.session.session import Event, Session
from hapticnet.scene.settings import Contact
from hapticnet.web import messages
from hapticnet.web.messages import MistakeError
from hapticnet.web.mirror import Mirror, scene_called
from hapticnet.web.replay import AskBlock, Replay, block
from hapticnet.web.tape import COLUMNS, tape_of_force, tape_of_session, together
from tests.web.staged import ORIGIN, Stage, serve_files

LAW = {"weber_fraction": 0.05, "floor_n": 0.025, "multiplier": 1.0}
BEGIN_US = 7_000_000


def in_force(t_us, codec="deadband", scene="paper:1", **law):
    settings = {"codec": codec, "parameters": {}, "rate_hz": 1000.0, "scene": scene, **LAW, **law}
    return Event(t_us, "SettingsInForce", json.dumps(settings))


def connected(t_us):
    return Event(t_us, "Connected", json.dumps({"grant": {"scene": "paper:1", "resumed": False}}))


def session_of(columns, rows, datagrams=(), events=(), side="master", **more):
    """Return a session whose main table has these rows."""
    tables = {"tick" if side == "master" else "step": dict(zip(columns, np.asarray(rows).T, strict=True))}
    main = next(iter(tables.values()))
    main["t_us"] = main["t_us"].astype(np.int64)
    if len(datagrams):
        tables["datagram"] = dict(zip(DATAGRAM_COLUMNS, np.asarray(datagrams).T.astype(np.int64), strict=True))
    return Session(side, {"report": {}}, more.pop("offset_us", 0), tables, tuple(events), **more)


def insertion(tmp_path, *, seconds=8.0, codec="deadband", every=7, events=None, **more):
    """Return a needle that goes into the scene and back, and every so many rows a packet with its force."""
    n = round(1000 * seconds)
    t_us = BEGIN_US + 1000 * np.arange(n)
    position_m = 0.045 * np.sin(np.pi * np.arange(n) / n).astype(np.float32).astype(float)
    true = np.array(Mirror(scene_called("paper:1"), is_new=True).forces_n(t_us.tolist(), position_m.tolist()))
    held = np.repeat(true[::every], every)[:n]
    zero = np.zeros(n)
    rows = np.stack([t_us, position_m, held, held, zero, zero, zero], axis=1)
    back = [(t, 0, Kind.FORCE, 21) for t in t_us[::every]] + [(t + 3, 1, Kind.POSITION, 20) for t in t_us]
    ended = Event(int(t_us[-1]) + 500, "Ended", '{"reason": "done"}')
    events = events or [ended, connected(BEGIN_US), in_force(BEGIN_US, codec)]
    session = session_of(master_columns(1), rows, back, events, **more)
    return tape_of_session(tmp_path / f"{codec}.mcap", session), true, held


def test_figures_at_any_time_are_those_of_the_rows_before_it_however_one_came_there(tmp_path):
    tape, true, held = insertion(tmp_path, every=40)
    times_us = [BEGIN_US, BEGIN_US + 400_000, BEGIN_US + 3_217_500, BEGIN_US + 7_999_000]
    forward = [tape.figures(each) for each in times_us]
    assert forward == [tape.figures(each) for each in reversed(times_us)][::-1]
    for t_us, figures in zip(times_us, forward, strict=True):
        rows, felt_rows = (t_us - BEGIN_US) // 1000 + 1, np.flatnonzero(held[: (t_us - BEGIN_US) // 1000 + 1])
        packets = [k for k in range(0, rows, 40) if BEGIN_US + 1000 * k > t_us - 1_000_000]
        seconds = min(1.0, max(0.2, (t_us - BEGIN_US) / 1e6))
        traffic, felt = figures["traffic"], figures["felt"]
        assert traffic["packets_per_s"] == pytest.approx(len(packets) / seconds, abs=0.1)
        assert traffic["bytes_per_s"] == pytest.approx(len(packets) * (21 + UDP_IPV4_HEADER_BYTES) / seconds, abs=0.1)
        assert traffic["raw_packets"] == len(felt_rows)
        assert traffic["packets"] == np.count_nonzero(felt_rows % 40 == 0)
        shown = slice(max(0, rows - 5000), rows)
        expected = error_report(WeberLaw(**LAW), true[shown, None], held[shown, None])
        assert felt["rmse_n"] == pytest.approx(expected.rmse_n, rel=1e-5)
        assert felt["exceed_jnd_fraction"] == pytest.approx(expected.exceed_jnd_fraction, abs=2e-4)
        expected = error_report(WeberLaw(**LAW), true[:rows, None], held[:rows, None])
        assert (felt["so_far"] > 0.1) == (rows > 3000), "there is something to tell apart"
        assert felt["so_far"] == pytest.approx(expected.exceed_jnd_fraction, abs=1e-12)


def test_a_change_of_codec_begins_the_totals_again_and_each_row_has_its_own_jnd(tmp_path):
    change_us = BEGIN_US + 4_000_000
    events = [connected(BEGIN_US), in_force(BEGIN_US), in_force(change_us, "raw", weber_fraction=1.0, floor_n=100.0)]
    tape, _, _ = insertion(tmp_path, events=events, every=40)
    before, after = tape.figures(change_us - 1000), tape.figures(change_us + 1_000_000)
    assert before["felt"]["exceed_jnd_fraction"] > 0 == after["felt"]["exceed_jnd_fraction"]
    assert after["traffic"]["raw_packets"] <= 1001 < before["traffic"]["raw_packets"]
    about = tape.description("A")
    assert [(each["t_s"], each["codec"]) for each in about["spans"]] == [(0.0, "deadband"), (4.0, "raw")]
    assert about["summary"]["codecs"] == ["deadband", "raw"]


def test_blocks_have_every_row_once_and_the_scene_of_its_time(tmp_path):
    tape, true, held = insertion(tmp_path)
    blocks = [tape.block(number) for number in range(9)]
    assert [begin_s for begin_s, _, _ in blocks] == list(range(9))
    rows = np.concatenate([columns for _, columns, _ in blocks], axis=1)
    assert rows[1 + COLUMNS.index("true")] == pytest.approx(true, abs=1e-6)
    assert rows[1 + COLUMNS.index("held")] == pytest.approx(held, abs=1e-6)
    assert rows[1 + COLUMNS.index("packets")].sum() == len(tape.back)
    frames = [np.concatenate(each) for each in zip(*(frames for _, _, frames in blocks), strict=True)]
    _, tip_m, _, surfaces_m, contacts = frames
    pressed = contacts[:, 0] == Contact.CONTACT
    assert len(tip_m) == pytest.approx(8 * 60, rel=0.06)
    assert surfaces_m[pressed, 0] == pytest.approx(tip_m[pressed, 0])
    assert set(contacts[:, 0]) == {Contact.NONE, Contact.CONTACT, Contact.PENETRATED}
    assert blocks[8][1].shape[1] == 0
    assert len(block(tape, AskBlock(0, 4_000_000_000))) == 32, "nothing beyond the end"


def test_several_axes_parts_and_a_slave_are_shown_as_far_as_they_are_known(tmp_path):
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(100, len(master_columns(3))))
    rows[:, 0] = BEGIN_US + 1000 * np.arange(100)
    recorded = session_of(master_columns(3), rows, events=[in_force(BEGIN_US, scene="phantom")])
    three = tape_of_session(tmp_path / "a", recorded)
    _, columns, (_, tip, push, _, _) = three.block(0)
    assert columns[3] == pytest.approx(np.linalg.norm(rows[:, 7:10], axis=1), rel=1e-6)
    assert (tip.shape[1], push.shape[1]) == (3, 3)
    assert {each[0] for each in three.description("")["shapes"]} == {"plane", "sphere"}
    assert three.figures(BEGIN_US)["felt"] is three.figures(BEGIN_US)["traffic"] is None
    names = master_columns(4, parse_parts(["force:3", "grip:1"]))
    rows = np.tile(np.arange(100.0)[:, None], len(names))
    parts = tape_of_session(tmp_path / "b", session_of(names, rows, is_whole=False))
    assert parts.axes == 3
    assert "cut off or damaged" in parts.notes[0]
    assert "first of its parts" in parts.notes[1]
    rows = np.stack([rows[:, 0], rows[:, 0] * 1e-4, *[np.ones(100)] * 2, *[np.zeros(100)] * 4], axis=1)
    slave = tape_of_session(tmp_path / "c", session_of(slave_columns(1), rows, events=[in_force(0)], side="slave"))
    assert slave.figures(99)["felt"]["rmse_n"] == 0
    assert slave.description("")["known"] == ["true", "received", "held", "error"]


def test_rows_out_of_order_without_numbers_or_missing_are_shown_as_they_can_be(tmp_path):
    rows = np.zeros((5, 7))
    rows[:, 0] = [3000, 1000, 2000, 2000, 4000]
    rows[:, 1] = [0.03, 0.01, 0.5, np.nan, 1e300]
    rows[:, 3] = [1.0, 2.0, 9.0, np.inf, 4.0]
    tape = tape_of_session(tmp_path / "a", session_of(master_columns(1), rows, events=[Event(0, "Connected", "[")]))
    assert tape.t_us.tolist() == [1000, 2000, 3000, 4000], "of rows of one time, the last counts"
    assert tape.position_m[:, 0].tolist() == [0.01, 0.01, 0.03, 0.03]
    assert np.isnan(tape.rows[2, 1])
    Replay([tape], print)  # its hello has no NaN
    with pytest.raises(FileError, match="no rows"):
        tape_of_session(tmp_path / "b", session_of(master_columns(1), np.zeros((0, 7))))
    with pytest.raises(FileError, match="columns are not those of a master"):
        tape_of_session(tmp_path / "c", session_of(("t_us", "x"), [[1, 2]]))


def test_a_force_of_another_program_has_no_packets_and_says_so(tmp_path):
    recording = Recording(np.arange(1000, dtype=np.int64) * 1000, np.ones((1000, 1)), None, ("fz",), ("scaled",))
    about = tape_of_force(tmp_path / "force.csv", recording).description("")
    assert (about["known"], about["notes"][1]) == (["true"], "scaled")
    assert "no packets" in about["notes"][0]


def test_two_recordings_share_a_clock_if_they_were_made_at_once(tmp_path):
    first, second, later = (insertion(tmp_path, seconds=1.0, offset_us=each)[0] for each in (0, 9, 3_600_000_000))
    assert [together(each) for each in ([first, second], [first, later], [first])] == [True, False, False]


def test_a_request_outside_the_specification_is_refused(tmp_path):
    replay = Replay([insertion(tmp_path, seconds=1.0)[0]], print)
    for said in ('{"type": "block", "tape": 0}', '{"type": "figures", "t_s": -1}', '{"type": "figures", "t_s": NaN}'):
        with pytest.raises(MistakeError):
            messages.parse_text(said, replay.further)
    with pytest.raises(MistakeError, match="no recording 1"):
        replay._obey(None, AskBlock(1, 0))


def open_replay(browser, tapes, *, speed=1.0, loop=False, **context) -> Stage:
    """Open the page, and answer it as the server does."""
    replay = Replay(tapes, print, speed=speed, loop=loop)
    page = browser.new_context(**{"viewport": {"width": 1280, "height": 720}, **context}).new_page()
    stage = Stage(page, Replay)
    serve_files(page, stage)

    def connect(socket):
        client = SimpleNamespace(post=socket.send, post_replaceable=socket.send)
        socket.on_message(lambda said: replay._obey(client, messages.parse_text(said, replay.further)))
        replay._greet(client)

    page.route_web_socket(f"{ORIGIN.replace('http', 'ws')}/socket/watch?token=t", connect)
    page.goto(f"{ORIGIN}/watch?token=t")
    stage.until(lambda: page.locator("#play").is_enabled())
    return stage


def shown_s(stage: Stage) -> float:
    minutes, seconds = stage.text("#time").partition(" /")[0].split(":")
    return 60 * float(minutes) + float(seconds)


def test_it_begins_when_it_is_seen_and_is_driven_by_keys_alone(chromium, tmp_path):
    tape, _, held = insertion(tmp_path)
    stage = open_replay(chromium, [tape])
    press = stage.page.keyboard.press
    stage.until(lambda: shown_s(stage) > 0.3)
    press("Space")
    stage.until(lambda: stage.text("#play") == "Play")
    for key, time_s in {"Home": 0.0, "ArrowRight": 1.0, "Shift+ArrowRight": 1.1, "ArrowLeft": 0.1, "End": 7.9}.items():
        press(key)
        stage.until(lambda time_s=time_s: shown_s(stage) == time_s)
    stage.until(lambda: "0:07.9 ended: done" in stage.text(".newest"))  # although it comes after the last row
    press("Home")
    _ = [press("ArrowRight") for _ in range(3)]
    expected = tape.figures(BEGIN_US + 3_000_000)
    tile = '[data-tile="packets"] .big'
    stage.until(lambda: stage.text(tile) == f"{expected['traffic']['packets_per_s']:.0f} /s")
    assert stage.text('[data-line="held"] output') == f"{held[3000]:.2f} N"
    assert "In force: deadband at 1 JND" in stage.text(".newest")
    slider = stage.page.get_by_role("slider", name="Time in the recording")
    assert slider.get_attribute("aria-valuetext") == "3.0 seconds of 8.0 seconds"
    assert stage.page.get_by_role("img", name="Scene: ").get_attribute("aria-label").startswith("Scene: 42 millimetres")
    _ = [press(key) for key in ("End", "l", "Space")]
    stage.until(lambda: 0.0 < shown_s(stage) < 3.0)
    assert stage.page.get_by_role("button", name="Loop", pressed=True).is_visible()
    assert stage.errors == []
    stage.page.context.close()


def test_it_plays_at_the_chosen_speed_and_waits_for_who_prefers_reduced_motion(chromium, tmp_path):
    stage = open_replay(chromium, [insertion(tmp_path)[0]], speed=0.3, reduced_motion="reduce")
    stage.page.wait_for_timeout(300)
    assert (shown_s(stage), stage.text("#play")) == (0.0, "Play")
    assert stage.page.get_by_label("Speed").input_value() == "0.3"
    stage.page.get_by_label("Speed").select_option("4")
    stage.page.get_by_role("button", name="Play").click()
    stage.until(lambda: shown_s(stage) == 7.9 and stage.text("#play") == "Play")
    assert stage.text("#announcer") == "The recording has ended"
    stage.page.context.close()


@pytest.mark.parametrize("width", [320, 768, 1280, 1920])
def test_two_recordings_are_side_by_side_where_the_window_is_wide_enough(chromium, tmp_path, width):
    tapes = [insertion(tmp_path, every=40)[0], insertion(tmp_path, codec="raw", every=1, seconds=3.0)[0]]
    stage = open_replay(chromium, tapes, viewport={"width": width, "height": 720}, color_scheme="dark")
    assert re.fullmatch(
        r"A \(deadband\) sent 97.5 % fewer packets than B \(raw\): 25 against 1,000 a second while a force was felt."
        r" More than one JND from the true force: A .*, B 0 % of the time. Recorded at the same time: .*",
        stage.text("#difference"),
    )
    first, second = (stage.page.get_by_role("article", name=f"Recording {each}").bounding_box() for each in "AB")
    assert (first["y"] == second["y"]) == (width >= 860)
    stage.page.keyboard.press("End")
    stage.until(lambda: stage.text("article:nth-child(2) .over") == "ended at 0:02.9")
    assert stage.page.evaluate("document.documentElement.scrollWidth") <= width
    assert stage.errors == []
    stage.page.context.close()
