"""A browser tab through a gateway, beside the same work over UDP: round trips, and what the hand feels.

The slave and the gateway are at the far end of a link that delays and drops IP packets, headless Chromium or a master
in Python at the near end. Round trips are of the messages of bench/measure/stacks, which the gateway carries as it
would carry sealed datagrams; what is felt is that of sealed sessions, with the same motion of the hand.
"""

import argparse
import functools
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import numpy as np
import record
from flood_roles import MASTER_KEY, SLAVE_KEY
from peer_felt import felt_ticks, true_forces_n
from peer_link import FAR_HOST, Link, cpu_us, link, sent
from peer_run import ENDS, REPOSITORY, End, Runner, StackError
from stacks import PORT

from hapticnet.errors import UnavailableError
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.keys import format_key
from hapticnet_gateway.cli import read_token
from peers import write_keys

RATE_HZ: Final = 250
"""Positions a second of the page if it sends each one; over UDP there are 1000."""

WEB_PORT: Final = 47890
SESSIONS: Final[dict[str, tuple[dict[str, Any], dict[str, str]]]] = {
    "deadband": ({"codec": "deadband"}, {"codec": "deadband", "positions": "all"}),
    "motion-predictive, predicted, few positions": (
        {"codec": "motion-predictive", "predicted": True, "positions": "line"},
        {"codec": "motion-predictive", "positions": "few"},
    ),
}
"""What a master over UDP asks for, and what the page's address says."""
LOSSES: Final = (0.0, 0.05)
PATHS: Final = ("UDP", "tab")
WITHIN_MS: Final = 60_000
SETTLE_S: Final = 1.0
"""Time after the session begins that is left out."""

ECHO: Final = """async ({ token, seconds, hz }) => {
  const { GatewayLink } = await import(`${location.origin}/gateway.js`);
  const link = new GatewayLink({ url: location.origin, token });
  while (link.state !== "open") await new Promise((resolve) => setTimeout(resolve, 50));
  const worker = new Worker("/ticker.js");
  const wait = (ms) => new Promise((resolve) => { worker.onmessage = resolve; worker.postMessage(ms); });
  const start = performance.now(), trips = [], message = new DataView(new ArrayBuffer(8));
  const now = () => Math.floor((performance.now() - start) * 1000);
  link.onmessage = (data) => trips.push(now() - new DataView(data.buffer, data.byteOffset).getUint32(0, true));
  const dropped = link.carried.dropped;
  let asked = 0;
  for (let due = 0; now() < seconds * 1e6; due = Math.max(due + 1e6 / hz, now())) {
    message.setUint32(0, now(), true);
    link.send(new Uint8Array(message.buffer.slice(0)));
    asked++;
    while (now() < due) await wait((due - now()) / 1000);
  }
  await wait(500);
  link.close();
  return { trips, asked, dropped: link.carried.dropped - dropped };
}"""

MOVE: Final = """(positions) => {
  let start;
  hapticnet.hand = (nowUs) => {
    start ??= nowUs;
    return [positions[Math.min(positions.length - 1, Math.floor((nowUs - start) / 1000))]];
  };
}"""


def near(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the tab: round trips without a codec, else the ticks of a sealed session."""
    from playwright.sync_api import sync_playwright

    url = f"http://{FAR_HOST}:{WEB_PORT}"
    fragment = {"token": arguments.token}
    if arguments.session is not None:
        keys = {"key": format_key(MASTER_KEY.private), "slave": format_key(SLAVE_KEY.public)}
        fragment |= keys | SESSIONS[arguments.session][1] | {"begin": "1"}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page()
        page.goto(f"{url}/#{urlencode(fragment)}")
        if arguments.session is None:
            found: dict[str, Any] = page.evaluate(
                ECHO, {"token": arguments.token, "seconds": arguments.seconds, "hz": RATE_HZ}
            )
        else:
            page.locator("#session[data-level=good]").wait_for(timeout=WITHIN_MS)
            hand = ScriptedOperator(InsertionSettings(insertions=1000), np.random.default_rng(arguments.seed))
            positions = [hand.sample(1000 * ms).position_m[0] for ms in range(round(1000 * arguments.seconds) + 2000)]
            begun_us = page.evaluate("Math.floor(performance.now() * 1000)")
            page.evaluate(MOVE, positions)
            page.wait_for_timeout(1000 * arguments.seconds)
            found = {"ticks": page.evaluate("hapticnet.ticks.since(0)"), "begun_us": begun_us}
        browser.close()
    return found


class Tab:
    """Measure the tab: the far end's processes, and the browser at the near end."""

    def __init__(self, folder: Path, keys: list[str], arguments: argparse.Namespace) -> None:
        self.seconds: float = arguments.seconds
        self._folder, self._keys, self._arguments = folder, keys, arguments
        self._environment = os.environ | {"PYTHONPATH": f"{REPOSITORY}:{REPOSITORY / 'extras' / 'gateway'}"}

    def run(self, wire: Link, session: str | None) -> dict[str, Any]:
        """Return what the tab saw, and the CPU time of the gateway [µs] a datagram that it carried."""
        with ExitStack() as ends:
            slave = ["-m", "hapticnet", "slave", "--listen", f"{FAR_HOST}:{PORT}", *self._keys, "--scene", "paper:1"]
            far = self._start(ends, wire, "far", [str(ENDS), "far", "UDP", FAR_HOST] if session is None else slave)
            far.line("ready" if session is None else "listening on")
            token = self._folder / "token.toml"
            listen = ["--slave", f"{FAR_HOST}:{PORT}", "--listen", f"{FAR_HOST}:{WEB_PORT}", "--token", str(token)]
            gateway = self._start(ends, wire, "gateway", ["-m", "hapticnet", "gateway", *listen])
            gateway.line("open file")
            seen = self._folder / "seen.json"
            command = [str(Path(__file__)), "--near", "--token", read_token(token), "--json", str(seen)]
            command += ["--seconds", str(self._arguments.seconds), "--seed", str(self._arguments.seed)]
            before, used_us = sent(gateway.process_id, wire.extra_bytes), cpu_us([gateway.process_id])
            done = subprocess.run(
                wire.command("near", [sys.executable, *command, *([] if session is None else ["--session", session])]),
                env=self._environment, capture_output=True, text=True,
                timeout=WITHIN_MS / 1000 + self._arguments.seconds,
            )  # fmt: skip
            if done.returncode:
                raise StackError(f"the tab failed: {done.stderr.strip()[-500:]}")
            after = sent(gateway.process_id, wire.extra_bytes)
            found: dict[str, Any] = json.loads(seen.read_text())
            return found | {
                "packets_back": after[0] - before[0], "bytes_back": after[1] - before[1],
                "gateway_us": cpu_us([gateway.process_id]) - used_us,
            }  # fmt: skip

    def _start(self, ends: ExitStack, wire: Link, name: str, arguments: list[str]) -> End:
        started = End(
            wire.command("far", [sys.executable, *arguments]), self._folder / f"{name}.txt", self._environment
        )
        ends.callback(started.end)
        return started


def felt(ticks: list[list[float]], begun_us: float) -> dict[str, float | None]:
    """Return what a hand felt, from the time [µs], the position [m] and the force held [N] of each tick."""
    times_us, positions_m, held_n = np.array([tick[:3] for tick in ticks]).T
    true_n = true_forces_n(positions_m, "paper:1")
    counted = times_us >= begun_us + 1e6 * SETTLE_S
    lags = felt_ticks(true_n, held_n)
    now = np.arange(len(ticks))
    ages_ms = np.where(lags < 0, np.inf, (times_us - times_us[now - np.maximum(lags, 0)]) / 1e3)[counted]
    p99_ms = float(np.percentile(ages_ms, 99, method="inverted_cdf"))
    return {
        "felt_p50_ms": float(np.percentile(ages_ms, 50, method="inverted_cdf")),
        "felt_p99_ms": p99_ms if np.isfinite(p99_ms) else None,
        "wrong": float(np.mean(lags[counted] != 0)),
        "rmse_n": float(np.sqrt(np.mean((held_n - true_n)[counted] ** 2))),
        "ticks_per_s": float(counted.sum() / (times_us[-1] - times_us[counted][0]) * 1e6),
    }


def trips(tab: Tab, runner: Runner, wire: Link, path: str) -> dict[str, Any]:
    """Return the round trips [ms] of messages, and the share of them that came back."""
    if path == "UDP":
        run = runner.run(wire, "UDP", None)
        return {"p50_ms": run["p50_us"] / 1e3, "p99_ms": run["p99_us"] / 1e3, "answered": run["answers"]}
    found = tab.run(wire, None)
    taken_ms = np.array(found["trips"]) / 1e3
    return {
        "p50_ms": float(np.percentile(taken_ms, 50)),
        "p99_ms": float(np.percentile(taken_ms, 99)),
        "answered": len(taken_ms) / found["asked"],
        "held_back": found["dropped"] / found["asked"],
        "gateway_us": found["gateway_us"] / (2 * len(taken_ms)),
    }


def session(tab: Tab, runner: Runner, wire: Link, path: str, name: str) -> dict[str, Any]:
    """Return what is felt in a sealed session."""
    if path == "UDP":
        seen = runner.run(wire, "hapticnet", SESSIONS[name][0] | {"sealed": True})["seen"]
        return felt(seen["ticks"], seen["ticks"][seen["warm_up"]][0] - 1e6 * SETTLE_S)
    found = tab.run(wire, name)
    return felt(found["ticks"], found["begun_us"]) | {"bytes_back_per_s": found["bytes_back"] / tab.seconds}


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results; a case that fails twice on a busy machine is left out, with a line."""
    if os.geteuid():
        raise UnavailableError("network namespaces and the lossy link need root: run this with sudo, or as root")
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        keys = write_keys(folder)
        tab = Tab(folder, keys, arguments)
        runner = Runner(folder, keys, ticks=round(1000 * arguments.seconds), seed=arguments.seed, fifo=False)
        cases = [("round trip", trips), *((each, functools.partial(session, name=each)) for each in SESSIONS)]
        for loss, (what, run), path in itertools.product(LOSSES, cases, PATHS):
            for _ in range(2):
                try:
                    with link(arguments.delay, loss, arguments.seed) as wire:
                        rows.append({"loss": loss, "what": what, "path": path, **run(tab, runner, wire, path)})
                except (StackError, subprocess.TimeoutExpired) as error:
                    print(f"{what}, {path}: {error}", file=sys.stderr, flush=True)
                else:
                    print(f"load average {os.getloadavg()[0]:.1f}: {rows[-1]}", file=sys.stderr, flush=True)
                    break
    return {"delay_ms": arguments.delay, "seconds": arguments.seconds, "rate_hz": RATE_HZ, "rows": rows}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument(
        "--seconds", type=record.within(2.0), default=10.0, help="length of each measurement, at most 14"
    )
    parser.add_argument("--delay", type=record.within(0.0), default=50.0, help="delay of the link [ms], each way")
    parser.add_argument("--near", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--token", help=argparse.SUPPRESS)
    parser.add_argument("--session", help=argparse.SUPPRESS)
    parser.set_defaults(repetitions=1)
    arguments = parser.parse_args()
    if arguments.near:
        arguments.json.write_text(json.dumps(near(arguments)), encoding="utf-8")
        return
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
