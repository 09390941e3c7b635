"""LeRobot's remote robot (LeKiwi): dictionaries as JSON over ZeroMQ, both ends in loops of their own at `hz`.

PUSH and PULL sockets that keep the newest message, one each way; a loop takes what has come, sends and sleeps. There
is one joint instead of LeKiwi's nine values, no camera, and a time stamp, by which the age of a force is measured.
"""

import asyncio
import contextlib
import json
import time

import zmq

from stacks import MESSAGE, PORT, Answer, Deliver, Ready, Send


def newest_only(kind: int) -> "zmq.Socket[bytes]":
    sock = zmq.Context.instance().socket(kind)
    sock.setsockopt(zmq.CONFLATE, 1)
    sock.setsockopt(zmq.LINGER, 0)
    return sock


async def serve(host: str, answer: Answer, ready: Ready, hz: float) -> None:
    commands, observations = newest_only(zmq.PULL), newest_only(zmq.PUSH)
    commands.bind(f"tcp://{host}:{PORT}")
    observations.bind(f"tcp://{host}:{PORT + 1}")
    ready()
    seen = {"t_us": 0, "x.pos": 0.0, "x.force": 0.0}
    while True:
        began_s = time.monotonic()
        try:
            action = json.loads(commands.recv_string(zmq.NOBLOCK))
        except zmq.Again:
            pass  # the observation is sent all the same
        else:
            t_us, force_n = MESSAGE.unpack(answer(MESSAGE.pack(action["t_us"], action["x.pos"])))
            seen = {"t_us": t_us, "x.pos": action["x.pos"], "x.force": force_n}
        with contextlib.suppress(zmq.Again):  # no peer is connected yet
            observations.send_string(json.dumps(seen), zmq.NOBLOCK)
        await asyncio.sleep(max(1.0 / hz - (time.monotonic() - began_s), 0.0))


async def connect(host: str, deliver: Deliver, hz: float) -> Send:
    commands, observations = newest_only(zmq.PUSH), newest_only(zmq.PULL)
    commands.connect(f"tcp://{host}:{PORT}")
    observations.connect(f"tcp://{host}:{PORT + 1}")
    due_s = 0.0

    def send(data: bytes) -> None:
        nonlocal due_s
        if (now_s := time.monotonic()) < due_s:
            return  # the hand moves on; LeRobot's loop sleeps
        due_s = max(due_s + 1.0 / hz, now_s)
        t_us, position_m = MESSAGE.unpack(data)
        try:
            seen = json.loads(observations.recv_string(zmq.NOBLOCK))
            deliver(MESSAGE.pack(seen["t_us"], seen["x.force"]))
        except zmq.Again:
            pass
        commands.send_string(json.dumps({"t_us": t_us, "x.pos": position_m}), zmq.NOBLOCK)

    return send
