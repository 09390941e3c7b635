"""The participant's page: what it is told, what it may do, and what happens when it goes."""

import functools
import json
import re
from pathlib import Path
from typing import Any

import pytest
from participant import Participant, session

from hapticnet.operator.live import HandState
from hapticnet.web import messages
from hapticnet.web.messages import CloseCode
from hapticnet.web.server import static_files
from hapticnet_experiment import screens
from hapticnet_experiment.page import Key, Noise, ParticipantPage
from hapticnet_experiment.plan import ConditionPlan, OrderPlan, Plan
from hapticnet_experiment.rows import OrderRow
from tests.web.rig import played, until
from tests.web.test_web_parts import assert_every_file_is_there

BEFORE = ("instructions", "consent")


def plan(
    *, practice: int = 0, trials: int = 1, forces_n: tuple[float, ...] = (2.0, 3.5, 5.0), **condition: Any
) -> Plan:
    order = OrderPlan(
        breach_forces_n=list(forces_n),
        practice=practice,
        practice_pairs=0,
        practice_rounds=1,
        trials=trials,
        break_s=0.0,
    )
    return Plan(condition=[ConditionPlan(**{"name": "none", "codec": "raw", **condition})], order=order)


async def to_the_trial(client: Participant) -> None:
    await client.go_on(*BEFORE)
    await client.see("trial")
    await client.hear("ready", ready=True)


@played
async def test_a_session_is_seen_felt_and_answered_on_the_page(tmp_path: Path):
    async with session(tmp_path, plan(practice=1, trials=2)) as run, run.open() as client:
        await client.go_on(*BEFORE, "practice")
        await client.answer()
        await client.go_on("feedback")
        for progress in ("0 of 2 trials", "1 of 2 trials"):
            await client.hear("task", screen="trial", progress=progress)
            client.frames.clear()
            await client.push(0.025, lambda: bool(client.frames) and client.frames[-1]["contacts"] == (1, 0, 0))
            await client.answer("132")
        await client.see("rating")
        await client.press("6")
        await client.see("done")
        assert [event for event in run.events() if event not in ("begin", "meet", "started")] == [
            "consent", "practice", "trial", "trial", "rating", "end",
        ]  # fmt: skip
        assert {row.order_answered for row in run.rows if row.event == "trial"} == {"132"}
        await until(lambda: client.closed)


@played
async def test_nothing_that_is_sent_depends_on_the_tissues_or_the_condition(tmp_path: Path):
    """Two sessions that differ in tissues, codec and what the device delivered are the same on the page."""

    async def play_one(out: Path, study: Plan, seed: int) -> tuple[list[str], list[OrderRow]]:
        async with session(out, study, seed=seed) as run, run.open() as client:
            run.rig.undelivered = 1
            await to_the_trial(client)
            await client.answer()
            await client.go_on("repeat")
            await client.push(0.079, lambda: bool(client.frames) and client.frames[-1]["contacts"] == (2, 2, 2))
            await client.say("set", codec="raw")
            await client.hear("error", message="the participant's page cannot do that")
            await client.answer()
            await client.see("rating")
            for frame in client.frames:
                assert frame == frame | surfaces_at(frame["tip_m"])
            await run.page.stop()
            await until(lambda: client.closed)
            texts = [text for text in client.raw if isinstance(text, str) and json.loads(text)["type"] != "hand"]
            # time goes on while it is sent
            texts = [re.sub(r'"wait_s": [0-9.]+', '"wait_s": 0', text) for text in texts]
            return texts, [row for row in run.rows if row.event in ("repeated", "trial")]

    texts, rows = await play_one(tmp_path / "one", plan(), 1)
    other = plan(forces_n=(1.8, 3.15, 4.5), name="4 JND", codec="deadband", multiplier=4.0)
    other_texts, other_rows = await play_one(tmp_path / "other", other, 5)
    assert other_texts == texts
    for field in ("breach_forces_n", "order_true", "condition", "codec"):
        assert getattr(rows[1], field) != getattr(other_rows[1], field)
    assert "delivered 0." in (rows[0].reason or "")
    assert {json.loads(text)["type"] for text in texts} == {"hello", "scene", "ready", "task", "error"}
    tissues = next(scene["tissues"] for scene in map(json.loads, texts) if scene.get("tissues"))
    assert [set(tissue) for tissue in tissues] == [{"name", "rest_m"}] * 3


def surfaces_at(tip_m: float) -> dict[str, Any]:
    """Return what a frame shows on the way into tissues of which each breaks at half the distance to the next."""
    contacts, surfaces_m = [], []
    for rest_m in (0.02, 0.04, 0.06):
        breaks_m = rest_m + 0.01
        if abs(tip_m - breaks_m) < 1e-6:
            return {}  # either side of the breach
        contacts.append(0 if tip_m <= rest_m else 1 if tip_m < breaks_m else 2)
        surfaces_m.append(pytest.approx(tip_m if contacts[-1] == 1 else rest_m, abs=1e-6))
    return {"contacts": tuple(contacts), "surfaces_m": tuple(surfaces_m)}


@played
async def test_a_page_closed_in_a_trial_ends_it_and_the_next_page_goes_on(tmp_path: Path):
    async with session(tmp_path, plan()) as run:
        async with run.open() as client:
            await to_the_trial(client)
            await client.push(0.03, lambda: run.hand.position_m[0] > 0.02)
        await until(lambda: "aborted" in run.events())
        assert run.rig.running is None
        assert (run.hand.state, run.hand.position_m) == (HandState.FREE, (0.0,))
        assert next(row.reason for row in run.rows if row.event == "aborted") == "the page was closed"
        async with run.open() as client:
            await client.go_on("repeat")
            await client.answer()
            await client.see("rating")
    assert run.events().count("trial") == 1


@played
async def test_without_a_page_nothing_is_rendered(tmp_path: Path):
    async with session(tmp_path, plan(trials=2)) as run:
        async with run.open() as client:
            await to_the_trial(client)
            await client.answer()  # the next trial begins at once, and nobody is there any more
        await until(lambda: "aborted" in run.events() and run.rig.running is None)
        async with run.open() as client:
            await client.see("repeat")


@played
async def test_a_second_page_cannot_answer(tmp_path: Path):
    async with session(tmp_path, plan()) as run, run.open() as client:
        await client.see("instructions")
        async with run.open() as other:
            await until(lambda: other.closed)
            assert other.socket.close_code == CloseCode.ANOTHER_PAGE
            assert other.json == []
        await client.go_on(*BEFORE)
        await client.see("trial")


@played
async def test_a_key_pressed_twice_answers_one_question(tmp_path: Path):
    async with session(tmp_path, plan()) as run, run.open() as client:
        task = await client.see("instructions")
        for _ in range(3):
            await client.say("key", number=task["number"], key="enter")
        await client.see("consent")
        await client.say("key", number=task["number"], key="y")
        await client.press("n")
        await client.see("done")
        assert run.events() == ["begin", "end"]


@pytest.mark.parametrize(("who", "reason"), [("participant", "the participant stopped"), ("experimenter", "the exp")])
@played
async def test_whoever_stops_a_trial_ends_it_at_once(tmp_path: Path, who: str, reason: str):
    async with session(tmp_path, plan()) as run, run.open() as client:
        await to_the_trial(client)
        if who == "participant":
            await client.press(screens.ESCAPE)
        else:
            run.page.hear_experimenter(screens.ESCAPE)
        task = await client.see("repeat")
        assert run.rig.stopped_us
        assert "it was stopped" in str(task["text"])
        assert run.rows[-1].event == "aborted"
        assert (run.rows[-1].reason or "").startswith(reason)
        assert f"This one comes again: {run.rows[-1].reason}" in run.said


@played
async def test_the_hand_can_be_taken_only_while_there_is_something_to_touch(tmp_path: Path):
    async with session(tmp_path, plan()) as run, run.open() as client:
        await client.see("instructions")
        await client.say("take")
        assert "nothing to touch" in (await client.hear("error"))["message"]
        assert run.hand.state is HandState.FREE
        await to_the_trial(client)
        await client.push(0.05, lambda: run.hand.position_m[0] > 0.01)
        await client.answer()
        await client.see("rating")
        assert (run.hand.state, run.hand.position_m) == (HandState.FREE, (0.0,))


@played
async def test_the_level_of_the_masking_noise_is_stored_at_once(tmp_path: Path):
    async with session(tmp_path, plan()) as run:
        async with run.open() as client:
            await client.see("instructions")
            for level in (0.2, 0.2, 0.36):
                await client.say("noise", level=level)
            await until(lambda: run.events().count("noise") == 2)
        await until(lambda: run.events().count("noise") == 3)  # a page that is closed is silent
        assert [row.text for row in run.rows if row.event == "noise"] == ["level 0.20", "level 0.36", "level 0.00"]
        table = next(tmp_path.rglob("*.tsv"))
        await until(lambda: table.read_text().count("\nnoise\t") == 3)


@played
async def test_only_the_operator_view_is_served_and_only_with_its_token(tmp_path: Path):
    async with session(tmp_path, plan()) as run:
        token = run.access.tokens["operator"]
        for path, status in (
            (f"/operator?token={token}", 200),
            ("/operator?token=guess", 403),
            (f"/watch?token={token}", 404),
            (f"/socket/watch?token={token}", 404),
        ):
            async with run.http.get(run.address(path)) as answer:
                assert answer.status == status, path
                if status == 403:
                    assert "<h2>This link does not open the page</h2>" in await answer.text()


@played
async def test_the_experimenter_reads_what_is_shown_and_never_the_condition(tmp_path: Path):
    async with session(tmp_path, plan(name="a secret")) as run, run.open() as client:
        await to_the_trial(client)
        await client.answer()
        await client.see("rating")
        assert run.said[:3] == ["Instructions", "the participant's page is open", "Consent"]
        assert "Feel the three tissues (0 of 1 trials)" in run.said
        assert not any("secret" in line or "raw" in line for line in run.said)


def test_what_a_participant_may_say():
    read = functools.partial(messages.parse_text, further=ParticipantPage.further)
    assert read('{"type": "key", "number": 7, "key": "enter"}') == Key(7, "enter")
    assert read('{"type": "noise", "level": 0}') == Noise(0.0)
    assert read('{"type": "take"}') is messages.Order.TAKE


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"type": "key", "key": "enter"}', "takes the number of a task and a key"),
        ('{"type": "key", "number": true, "key": "enter"}', "takes the number of a task and a key"),
        ('{"type": "key", "number": 1, "key": 1}', "takes the number of a task and a key"),
        ('{"type": "noise", "level": NaN}', "a level between 0 and 1"),
        ('{"type": "noise", "level": true}', "a level between 0 and 1"),
        ('{"type": "noise"}', "a level between 0 and 1"),
    ],
)
def test_a_malformed_message_is_refused_in_one_line(text: str, complaint: str):
    with pytest.raises(messages.MistakeError, match=complaint):
        messages.parse_text(text, ParticipantPage.further)


def test_every_file_that_the_page_names_is_there():
    files = static_files(ParticipantPage.packages)
    assert_every_file_is_there(files)
    assert b"participant.js" in files["operator.html"][0]
