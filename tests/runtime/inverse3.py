"""A stand-in for Haply's local service and one Inverse3, held by a hand that yields to its force."""

import asyncio
import json
import threading
import time
from types import SimpleNamespace

from aiohttp import web

from hapticnet.operator.yielding import HandSettings, YieldingOperator
from hapticnet.samples import PositionSample

REST_M = {"x": 0.01, "y": -0.12, "z": 0.15}
HAND = HandSettings(mass_kg=0.1, damping_n_s_per_m=5.0, stiffness_n_per_m=135.0)


def state(position_m, *, button=False, device_id="049D"):
    """Return a message as the service documents it."""
    device = {"device_id": device_id, "state": {"cursor_position": position_m, "control_mode": "idle"}}
    grip = {"buttons": {"a": button, "b": False, "c": False}, "hall": 30}
    return {
        "session_id": 7,
        "inverse3": [{**device, "config": {"type": "inverse3", "handedness": "right"}}],
        "wireless_verse_grip": [{"device_id": "6130", "state": grip}],
    }


class StandIn:
    """Answers each message with one state. `fault` is what it does instead; `forces`: time [s] and force of each."""

    def __init__(self, deepest_m=0.03):
        def push(t_us):
            return PositionSample(t_us, (min(deepest_m, 0.03e-6 * t_us),))

        self.hand = YieldingOperator(SimpleNamespace(axes=1, duration_us=None, sample=push), HAND)
        self.fault, self.button = "", False
        self.forces, self.down_m, self.connections = [(0.0, 0.0)], 0.0, 0

    def __enter__(self):
        ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._play(ready)))
        self._thread.start()
        assert ready.wait(10)
        return self

    def __exit__(self, *_):
        self.fault = "close"
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(10)

    @property
    def force(self):
        """The newest force [N] on the device, upward."""
        return self.forces[-1][1]

    async def _play(self, ready):
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        app = web.Application()
        app.router.add_get("/", self._serve)
        runner = web.AppRunner(app, shutdown_timeout=0.1)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        self.address = "127.0.0.1:{}".format(*runner.addresses[0][1:])
        ready.set()
        await self._over.wait()
        await runner.cleanup()

    async def _serve(self, request):
        to = web.WebSocketResponse(timeout=0.1)
        await to.prepare(request)
        self.connections += 1
        await to.send_str(self._answer())
        async for message in to:
            order = message.json()["inverse3"][0]["commands"]["set_cursor_force"]["vector"]
            assert order["x"] == order["y"] == 0.0
            self._apply(order["z"])
            while self.fault == "silent":
                await asyncio.sleep(0.01)
            if self.fault == "close":
                break
            await asyncio.sleep(0.01 if self.fault == "slow" else 0)
            await to.send_str(self._answer())
        self.hand.feel(round(1e6 * time.monotonic()), (0.0,))  # nobody commands a force: the device is idle
        return to

    def _apply(self, force_n):
        at_s = time.monotonic()
        self.forces.append((at_s, force_n))
        t_us = round(1e6 * (at_s - self.forces[1][0]))
        self.hand.feel(t_us, (force_n,))
        self.down_m = self.hand.sample(t_us).position_m[0]

    def _answer(self):
        place = REST_M | {"z": float("nan") if self.fault == "nan" else REST_M["z"] - self.down_m}
        answer = state(place, button=self.button, device_id="0001" if self.fault == "other" else "049D")
        if self.fault == "minverse":
            answer["inverse3"][0]["config"]["type"] = "minverse"
        return "{half" if self.fault == "garbage" else json.dumps(answer)
