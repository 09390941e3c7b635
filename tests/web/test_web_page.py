"""The page beside a running master: what each view gets, and what it can do."""

import asyncio
import json

import aiohttp
import numpy as np
import pytest

from hapticnet.control.swing import SwingWatch
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.operator.yielding import scripted_yielding
from hapticnet.perception import WeberLaw
from hapticnet.scene.settings import SceneSettings, Tissue
from hapticnet.web import messages
from hapticnet.web.messages import CloseCode
from tests.web.rig import WITHIN_S, Client, Rig, played, rig, until


async def push(client: Client, position_m: float, seconds: float) -> None:
    """Hold the hand at a position."""
    for _ in range(round(seconds / 0.05)):
        await client.move(position_m)
        await asyncio.sleep(0.05)


async def take(run: Rig, client: Client) -> None:
    await until(lambda: run.node.connected)
    await client.say("take")
    await client.hear("hand", holder="you", state="live")


@played
async def test_samples_arrive_without_gaps_and_the_force_follows_the_hand():
    async with rig() as run, run.open("watch") as client:
        await take(run, client)
        await push(client, 0.027, 0.7)
        await until(lambda: client.newest("held")[-1] > 1.0)
        following, _, _ = client.blocks[0]
        for number, _, block in client.blocks:
            assert number == following
            following += block.shape[1]
        columns = client.columns()
        assert (np.diff(columns["t"]) > 0).all()
        assert np.nanmedian(np.abs(columns["true"] - columns["held"])) < 0.1
        assert columns["packets"].sum() > 10
        assert client.frames[-1]["contacts"] == (1, 0, 0)
        assert client.frames[-1]["surfaces_m"][0] == client.frames[-1]["tip_m"]
        assert client.frames[-1]["time_ms"] == 1.0
        feedback = (await client.hear("state", link="established"))["feedback"]
        assert feedback["bytes"] < 0.5 * feedback["raw_bytes"]


def told(client: Client) -> list[str]:
    """Return which messages came; those about the hand depend on how busy this machine is."""
    return [each["type"] for each in client.json if each["type"] != "hand"]


@played
async def test_the_operator_view_gets_nothing_that_gives_an_answer_away():
    async with rig(scene="paper:3") as run, run.open("operator") as operator, run.open("watch") as watcher:
        await take(run, operator)
        await push(operator, 0.027, 0.4)
        before = told(operator)
        await watcher.say("set", codec="raw", multiplier=4, delay_ms=5, loss_percent=1)
        await watcher.hear("state", codec="raw", multiplier=4.0)
        await until(lambda: watcher.last("state")["connections"] == 2)
        await push(operator, 0.027, 0.4)
        assert told(operator) == before  # a change of the condition cannot be seen
        assert {each["type"] for each in operator.json} == {"hello", "scene", "ready", "hand"}
        for message in operator.json:
            assert message.keys() <= {
                "type", "version", "view", "messages_per_s", "hand", "known", "range_m", "tissues", "ready",
                "holder", "state", "axes", "reach_m",
            }  # fmt: skip
        assert operator.last("scene")["tissues"] == [{"rest_m": 0.02}, {"rest_m": 0.04}, {"rest_m": 0.06}]
        assert not operator.blocks
        known = operator.last("scene")["known"]
        shown = [data for data in operator.raw if isinstance(data, bytes)]
        assert known
        assert {data[0] for data in shown} == {messages.FRAME}
        assert {len(data) for data in shown if data[2]} == {20 + 3 * 5}
        for name in ("paper", "deadband", '"raw"', "_n", "stiff", "breach", "tissue 1"):
            assert not any(name in json.dumps(message) for message in operator.json), name


def swings(client):
    """Return the warnings that the hand begins to swing."""
    return [each for each in client.json if "begins to swing" in each.get("text", "")]


def seen_s(ticks):
    """Return the time [s] of the first of these ticks at which the hand swings."""
    port = SwingWatch()
    for t_s, force_n, position_m in zip(ticks["t"], ticks["held"], ticks["position"], strict=True):
        port.add(round(1e6 * t_s), (force_n,), (position_m,), WeberLaw())
        if port.swings(round(1e6 * t_s)):
            return t_s
    raise AssertionError("no swing was seen")


@played
async def test_a_hand_that_yields_shows_its_energy_and_a_warning_before_it_swings_far():
    hand = scripted_yielding("hand:finger", 1, 3, np.random.default_rng(1))
    wall = Tissue(name="wall", rest_position_m=0.015, stiffness_n_per_m=600.0, breach_force_n=1000.0)
    async with (
        rig(operator=hand, scene=SceneSettings(name="wall", tissues=(wall,))) as run,
        run.open("watch") as client,
    ):
        await client.say("set", delay_ms=10)
        await until(lambda: swings(client))
        state = await client.hear("state", delay_ms=10.0)
        await until(lambda: client.last("state")["port"]["created_j"] > 0.01)
        assert state["port"].keys() == {"put_in_j", "given_back_j", "created_j", "swings"}
        assert "--coupling energy-bounded" in run.said[-1]
        # How large the swing is when it is seen depends on this machine; tests/control bounds it in virtual time.
        assert 0.0 <= swings(client)[0]["t_s"] - seen_s(client.columns()) < 0.3
        await client.say("set", delay_ms=0)
        await client.hear("state", delay_ms=0.0)
        assert client.last("state")["port"]["created_j"] < 0.01  # since the change


@played
async def test_a_script_can_be_watched_but_not_taken_and_its_end_is_told():
    hand = ScriptedOperator(InsertionSettings(), np.random.default_rng(1))
    async with rig(operator=hand) as run, run.open("watch") as client:
        assert (await client.hear("state"))["port"] is None
        assert client.json[0]["hand"]["source"] == "scripted"
        await client.say("take")
        assert "no hand to take" in (await client.hear("error"))["message"]
        assert client.last("hand") == {"type": "hand", "holder": "nobody", "state": "free"}
        run.stop.set()
        await until(lambda: client.socket.closed)
        assert client.socket.close_code == CloseCode.MASTER_ENDED


@played
async def test_one_page_has_the_hand_and_when_it_goes_the_needle_is_withdrawn():
    async with rig() as run, run.open("operator") as other:
        async with run.open("watch") as client:
            await take(run, client)
            await push(client, 0.01, 0.5)
            assert (await other.hear("hand", holder="another"))["state"] == "live"
            await other.say("take")
            assert (await other.hear("error"))["message"] == "another page moves the needle"
            await other.move(0.09)
            await push(client, 0.01, 0.1)
            assert run.hand is not None
            assert run.hand.position_m[0] < 0.011
        await other.hear("hand", holder="nobody", state="withdrawing")
        await other.hear("hand", holder="nobody", state="free")
        assert run.node.position_m == (0.0,)
        await take(run, other)
        await other.say("release")
        await other.hear("hand", holder="nobody")


@played
async def test_a_page_that_falls_silent_loses_the_hand():
    async with rig() as run, run.open("watch") as client:
        await take(run, client)
        await push(client, 0.01, 0.3)
        await client.hear("hand", holder="you", state="holding")
        await client.hear("hand", holder="nobody", state="withdrawing")
        await client.hear("hand", holder="nobody", state="free")
        await client.move(0.01)
        await asyncio.sleep(0.1)
        assert run.node.position_m == (0.0,)


@played
async def test_whoever_watches_can_let_go():
    async with rig() as run, run.open("operator") as operator, run.open("watch") as watcher:
        await take(run, operator)
        await push(operator, 0.01, 0.2)
        await operator.say("let_go")
        assert (await operator.hear("error"))["message"] == "the operator view cannot do that"
        assert operator.last("hand")["holder"] == "you"
        await watcher.say("let_go")
        await operator.hear("hand", holder="nobody")


@played
async def test_settings_change_while_it_runs_and_the_scene_stays():
    async with rig(scene=brittle()) as run, run.open("watch") as client:
        await take(run, client)
        await push(client, 0.012, 0.5)  # through the only tissue
        await client.hear("scene", known=False, name="foil", tissues=[])  # one's own is not shown
        assert client.frames[-1]["surfaces_m"] == ()
        assert np.isnan(client.columns()["true"]).all()
        for multiplier in (0.5, 1.0, 1.5, 2.0):
            await client.say("set", multiplier=multiplier)
        await client.say("set", codec="linear-predictive")
        await until(lambda: client.last("state").get("connections", 0) >= 2 and run.node.session.streaming)
        state = await client.hear("state", codec="linear-predictive", multiplier=2.0)
        assert state["connections"] <= 3  # a dragged slider asks for few sessions
        assert state["since_s"] > 0
        await push(client, 0.012, 0.3)
        assert client.newest("held")[-1] == 0.0  # still pierced
        await client.say("set", delay_ms=20, loss_percent=50)
        await client.hear("state", delay_ms=20.0, loss_percent=50.0)
        in_force = [each for _, each in run.node.in_force.history]
        assert {each.multiplier for each in in_force} >= {1.0, 2.0}, "recordings are told what a page changes"
        assert (in_force[-1].codec, in_force[-1].channel_out) == ("linear-predictive", "delay=20ms,loss=50%")
        assert not [text for text in client.last("event").values() if "SettingsInForce" in str(text)]
        before = client.last("state")["lost"]
        await push(client, 0.005, 0.6)
        await until(lambda: client.last("state")["lost"] > before)
        assert not client.last("error")


def brittle() -> SceneSettings:
    tissue = Tissue(name="foil", rest_position_m=0.004, stiffness_n_per_m=300.0, breach_force_n=0.6)
    return SceneSettings(name="foil", tissues=(tissue,))


@played
async def test_a_setting_that_is_refused_changes_nothing():
    async with rig() as run, run.open("watch") as client:
        await client.hear("state", link="established")
        for content, complaint in (
            ({"codec": "best", "delay_ms": 9}, "unknown codec 'best'"),
            ({"codec": "evil.py:Codec"}, "unknown codec"),
            ({"multiplier": 5e-324}, "multiplier"),
            ({"loss_percent": 99}, "loss_percent is 99; it must be between 0 and 50"),
        ):
            await client.say("set", **content)
            await until(lambda expected=complaint: expected in client.last("error").get("message", ""))
        state = await client.hear("state")
        assert (state["codec"], state["delay_ms"], state["connections"]) == ("deadband", 0.0, 1)
        assert run.node.connected


@played
async def test_without_a_slave_the_page_says_that_there_is_nothing_to_touch():
    async with rig(with_slave=False) as run, run.open("operator") as client:
        await client.hear("ready", ready=False)
        await client.hear("scene", known=False)
        await until(lambda: len(client.frames) > 3)
        assert run.said == []


async def ended(page: Client, good: Client) -> None:
    """Wait until a page is disconnected; `good` moves meanwhile, because a silent page loses the hand."""
    async with asyncio.timeout(WITHIN_S):
        while not page.socket.closed:
            await good.move(0.01)
            await asyncio.sleep(0.02)


@played
async def test_malformed_messages_are_told_once_and_end_only_that_page():
    async with rig() as run, run.open("watch") as good, run.open("watch") as bad:
        await take(run, good)
        for number in range(messages.MOST_MISTAKES):
            await (bad.socket.send_str("{") if number % 2 else bad.socket.send_bytes(b"\xff" * number))
        await ended(bad, good)
        assert bad.socket.close_code == CloseCode.TOO_MANY_MISTAKES
        async with run.open("watch") as another:
            await another.socket.send_str("{")
            await another.hear("error")
        assert len(run.said) == 1, "pages that connect again and again with nonsense fill no log"
        assert "makes no sense" in run.said[0]
        await push(good, 0.01, 0.3)
        assert good.last("hand")["holder"] == "you"
        async with run.open("watch") as big:
            await big.socket.send_str("x" * (messages.LARGEST_MESSAGE + 1))
            await ended(big, good)
        await push(good, 0.01, 0.1)
        assert good.last("hand")["holder"] == "you"
        assert run.node.failure is None


@played
async def test_a_stranger_gets_nothing():
    async with rig() as run:
        token = run.access.tokens["watch"]
        own = {"Origin": run.address("")}
        for path, headers, status in (
            (f"/watch?token={token}", {}, 200),
            ("/watch", {}, 403),
            (f"/operator?token={token}", {}, 403),
            ("/watch?token=%C3%A4", {}, 403),
            (f"/watch?token={token}", {"Host": "evil.example"}, 421),
            ("/static/watch.html", {}, 404),
            ("/static/../page.py", {}, 404),
            ("/static/%2e%2e/page.py", {}, 404),
            ("/", {}, 404),
        ):
            async with run.http.get(run.address(path), headers=headers) as answer:
                assert answer.status == status, path
                assert "default-src 'none'" in answer.headers["Content-Security-Policy"] or status == 404
        for headers in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "http://[::1"}):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await run.http.ws_connect(run.address(f"/socket/watch?token={token}"), headers=headers)
        for path in ("/socket/watch", f"/socket/operator?token={token}"):
            async with run.http.ws_connect(run.address(path), headers=own) as socket:
                assert (await socket.receive()).data == CloseCode.WRONG_TOKEN
        assert run.page.clients == []


@played
async def test_a_page_that_fails_is_switched_off_and_the_run_goes_on(monkeypatch: pytest.MonkeyPatch):
    async with rig() as run, run.open("watch") as client:
        await take(run, client)
        monkeypatch.setattr(run.page, "_send_frames", lambda *_: 1 / 0)
        await until(lambda: any("switched off" in line for line in run.said))
        ticks = run.node.ticks
        await until(lambda: run.node.ticks > ticks + 50)
        assert run.node.failure is None


@played
async def test_a_scene_of_three_axes_is_described_and_touched():
    async with rig(scene="phantom") as run, run.open("operator") as operator, run.open("watch") as watcher:
        shapes = await watcher.hear("shapes", count=2)
        assert (shapes["changed"]["0"][0], shapes["changed"]["1"][:2]) == ("plane", ["sphere", [0.034, 0.004, 0.0]])
        assert await operator.hear("shapes", count=2) == shapes, "the looks of a scene say nothing of its forces"
        scene = await watcher.hear("scene", axes=3)
        assert (scene["known"], scene["reach_m"]) == (False, 0.05)
        await operator.say("take")
        await operator.hear("hand", holder="you")

        def is_felt() -> bool:
            further = watcher.frames[-1]["further"] if watcher.frames else ()
            return len(further) == 5 and further[2] > 1.0 and further[:2] == pytest.approx((0.01, -0.02), abs=1e-4)

        async with asyncio.timeout(WITHIN_S):
            while not is_felt():
                await operator.move(0.028, 0.01, -0.02)
                await asyncio.sleep(0.05)
        assert watcher.frames[-1]["further"][3] > 0, "the skin is tilted, so it pushes aside, too"
        assert all(len(frame["further"]) == 2 for frame in operator.frames if frame["further"])
        await operator.move(0.028)
        await operator.hear("error", message="the hand has 1 axis; in this run it has 3")
