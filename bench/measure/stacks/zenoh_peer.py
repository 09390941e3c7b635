"""Zenoh: two peers without a router and without scouting; express, real-time priority, non-blocking."""

import asyncio
import json

import zenoh

from stacks import PORT, Answer, Deliver, Ready, Send

POSITIONS, FORCES = "touch/position", "touch/force"


def open_session(transport: str, *, listen: str | None = None, connect: str | None = None) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([f"{transport}/{listen}:{PORT}"] if listen else []))
    config.insert_json5("connect/endpoints", json.dumps([f"{transport}/{connect}:{PORT}"] if connect else []))
    return zenoh.open(config)


def publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
        reliability=zenoh.Reliability.BEST_EFFORT,
    )


async def serve(host: str, answer: Answer, ready: Ready, *, transport: str) -> None:
    session = open_session(transport, listen=host)
    forces = publisher(session, FORCES)
    subscriber = session.declare_subscriber(POSITIONS, lambda sample: forces.put(answer(sample.payload.to_bytes())))
    ready()
    await asyncio.Event().wait()
    subscriber.undeclare()


async def connect(host: str, deliver: Deliver, *, transport: str) -> Send:
    session = open_session(transport, connect=host)
    positions = publisher(session, POSITIONS)
    subscriber = session.declare_subscriber(FORCES, lambda sample: deliver(sample.payload.to_bytes()))
    while not positions.matching_status.matching:
        await asyncio.sleep(0.05)

    def send(data: bytes, _kept: object = (session, subscriber)) -> None:
        positions.put(data)

    return send
