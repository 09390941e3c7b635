"""What the live page costs the master: the lateness of its ticks without and with a page, in turns.

The page is read by WebSocket clients in this process, and by Chromium where there is one; there the hand moves, too.
"""

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import aiohttp
import numpy as np
import record

from hapticnet.cli.pages import address_in, address_of
from hapticnet.runtime.children import Child
from hapticnet.runtime.realtime import OTHER
from hapticnet.web.ticks import Ticks

CHROMIUM = shutil.which("chromium")
WITHOUT = "without page"
NOBODY = "page, nobody there"
CLIENTS = {"one client": 1, "eight clients": 8}
BROWSER = "Chromium"
HAND = "Chromium, keys move the needle"


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    cases = [WITHOUT, NOBODY, *CLIENTS, *([BROWSER, HAND] if CHROMIUM else [])]
    runs: dict[str, list[dict[str, Any]]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for _ in range(arguments.repetitions):
            for case in cases:
                runs[case].append(play(case, arguments.seconds, Path(folder) / "master.json", browser))
    return {
        "scheduling": runs[WITHOUT][0]["scheduling"],
        "real time": not runs[WITHOUT][0]["scheduling"].startswith(OTHER),
        "cases": {case: summary(runs[case], runs[WITHOUT]) for case in cases},
        "in the tick us": cost_in_tick_us(),
    }


def play(case: str, seconds: float, report: Path, browser: Any) -> dict[str, Any]:
    """Run a slave and a master for so long, and return the master's report."""
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper:1"])
    master = None
    try:
        arguments = ["master", "--connect", slave.address(), "--duration", str(seconds), "--quiet"]
        arguments += ["--operator", "page" if case == HAND else "scripted", "--insertions", "1000"]
        arguments += ["--report", str(report), *(["--page=127.0.0.1:0"] if case != WITHOUT else [])]
        master = Child(arguments)
        with watched(case, master, browser):
            for _ in master.lines():
                pass
        master.finish()
        account: dict[str, Any] = json.loads(report.read_text())
        return account
    finally:
        for child in (master, slave):
            if child is not None:
                child.end()


@contextlib.contextmanager
def watched(case: str, master: Child, browser: Any) -> Iterator[None]:
    """Open what reads the page, until the master ends."""
    if case == WITHOUT:
        yield
        return
    url = next(address_of(file) for line in master.lines() if (file := address_in(line)[0]))
    if case in (BROWSER, HAND):
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.goto(url)
        if case == HAND:
            page.locator("canvas#scene").focus()
            page.keyboard.down("ArrowDown")
        yield
        page.close()
    else:
        readers = threading.Thread(target=lambda: asyncio.run(read(url, CLIENTS.get(case, 0))))
        readers.start()
        yield
        readers.join()


async def read(url: str, clients: int) -> None:
    """Read the page's messages with so many clients."""
    parts = urlsplit(url)
    origin = f"http://{parts.netloc}"

    async def client(http: aiohttp.ClientSession) -> None:
        address = f"{origin}/socket/watch?{parts.query}"
        async with http.ws_connect(address, headers={"Origin": origin}) as socket:
            async for _ in socket:
                pass

    async with aiohttp.ClientSession() as http:
        await asyncio.gather(*(client(http) for _ in range(clients)))


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """Start a browser; None where there is none."""
    if CHROMIUM is None:
        yield None
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox"] if os.getuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


def cost_in_tick_us() -> float:
    """Return the time [µs] that the page takes in a tick, best of 5."""
    node = SimpleNamespace(
        position_m=(0.02,), received_n=(1.0,), held_n=(1.0,), target_n=1.0, sensed_n=1.0, displacement_m=1e-3,
        session=SimpleNamespace(received=SimpleNamespace(by_kind=[0] * 10)),
    )  # fmt: skip
    best_s = np.inf
    for _ in range(5):
        ticks = Ticks(node, 0)  # type: ignore[arg-type]
        start_s = time.perf_counter()
        for now_us in range(20_000):
            ticks.add(now_us)
        best_s = min(best_s, time.perf_counter() - start_s)
    return best_s / 20_000 * 1e6


def summary(runs: list[dict[str, Any]], without: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians over the repetitions; the ratio is that of the same repetition."""
    return {
        **{key: float(np.median([run["lateness"][key] for run in runs])) for key in ("p50_us", "p99_us", "p99_9_us")},
        "missed_share": float(np.median([run["missed_ticks"] / run["ticks"] for run in runs])),
        "p99_ratio": float(
            np.median([a["lateness"]["p99_us"] / b["lateness"]["p99_us"] for a, b in zip(runs, without, strict=True)])
        ),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=12.0, help="length of each run")
    parser.add_argument("--repetitions", type=record.within(1), default=3)
    record.run(parser, measure, unit="us")


if __name__ == "__main__":
    main()
