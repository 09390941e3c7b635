"""The page beside a running master: what each view gets, and what it can do."""

import asyncio

import numpy as np

from tests.web.rig import play, rig, until


def test_samples_arrive_without_gaps_and_the_force_follows_the_hand():
    async def scenario() -> None:
        async with rig() as run, run.open("watch") as client:
            await client.hear("ready", ready=True)
            await client.say("take")
            await client.hear("hand", holder="you", state="live")
            for _ in range(15):
                await client.move(0.027)
                await asyncio.sleep(0.05)
            await until(lambda: client.columns()["held"][-1] > 1.0)
            first, _, _ = client.blocks[0]
            for number, _, block in client.blocks:
                assert number == first
                first += block.shape[1]
            columns = client.columns()
            assert (np.diff(columns["t"]) > 0).all()
            assert np.nanmax(np.abs(columns["true"] - columns["held"])) < 0.3
            assert client.frames[-1]["contacts"] == (1, 0, 0)
            assert client.frames[-1]["surfaces_m"][0] == client.frames[-1]["tip_m"]

    play(scenario)
