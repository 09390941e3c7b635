"""The page in a browser without a master: files come from the package, and a test plays the server."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page, Route, WebSocketRoute

from hapticnet.operator.live import HandState
from hapticnet.web import messages
from hapticnet.web.audience import Audience
from hapticnet.web.messages import Hand, View
from hapticnet.web.server import HEADERS, static_files

ORIGIN = "http://127.0.0.1:47880"
TISSUES = [
    {"rest_m": 0.02, "name": "skin", "stiffness_n_per_m": 200.0, "breach_force_n": 2.0},
    {"rest_m": 0.04, "name": "liver", "stiffness_n_per_m": 350.0, "breach_force_n": 3.5},
]
TRAFFIC = {
    "packets_per_s": 21, "bytes_per_s": 1344, "raw_packets_per_s": 1000, "raw_bytes_per_s": 49000,
    "packets": 30, "bytes": 1920, "raw_packets": 1000, "raw_bytes": 49000,
}  # fmt: skip
STATE = {
    "t_s": 1.0, "link": "established", "connections": 1, "sealed": False, "codec": "deadband", "parameters": {},
    "multiplier": 1.0, "weber_fraction": 0.05, "floor_n": 0.025, "delay_ms": 0, "loss_percent": 0,
    "round_trip_ms": 0.4, "arrived": 30, "lost": 0, "device": "ready", "since_s": 0.0,
    "pages": {"watch": 1, "operator": 0, "left_out": 0},
    "feedback": TRAFFIC, "forward": TRAFFIC,
}  # fmt: skip


@dataclass
class Stage:
    """An open page, and what it said."""

    page: Page
    served: type[Audience] = Audience
    hello: dict[str, Any] = field(default_factory=dict)  # what a page of a package has further in its hello
    sockets: list[WebSocketRoute] = field(default_factory=list)
    said: list[dict[str, Any]] = field(default_factory=list)
    hands: list[Hand] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    rows: int = 0

    def tell(self, kind: str, **content: Any) -> None:
        self.sockets[-1].send(messages.text(kind, **content))

    def show(self, tip_m: float, surfaces_m: tuple[float, ...], contacts: tuple[int, ...]) -> None:
        self.sockets[-1].send(messages.frame(HandState.LIVE, self.rows, 0.0, tip_m, surfaces_m, contacts))

    def send_samples(self, rows: int = 100, **values: float) -> None:
        """Send rows in which each column has one value."""
        columns = np.zeros((len(messages.COLUMNS), rows))
        columns[0] = np.arange(rows) / 1000
        for name, value in values.items():
            columns[messages.COLUMNS.index(name)] = value
        self.sockets[-1].send(messages.samples(self.rows, self.rows / 1000, columns))
        self.rows += rows

    def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(200):
            if condition():
                return
            self.page.wait_for_timeout(20)
        raise AssertionError("it did not happen within 4 s")

    def text(self, selector: str) -> str:
        return self.page.locator(selector).inner_text()

    def heard(self, kind: str) -> list[dict[str, Any]]:
        return [each for each in self.said if each["type"] == kind]


def serve_files(page: Page, stage: Stage) -> None:
    """Answer each request with a file of the package, as the server does."""
    files = static_files(stage.served.packages)

    def answer(route: Route) -> None:
        stage.requests.append(route.request.url)
        name = route.request.url.removeprefix(f"{ORIGIN}/").partition("?")[0].removeprefix("static/")
        body, kind = files[stage.served.documents.get(name, name)]
        route.fulfill(body=body, content_type=kind, headers=HEADERS)

    page.route("**/*", answer)
    page.on("pageerror", lambda error: stage.errors.append(str(error)))
    page.on("console", lambda message: stage.errors.append(message.text) if message.type == "error" else None)


def open_view(
    browser: Browser, view: View, served: type[Audience] = Audience, hello: dict[str, Any] | None = None, **context: Any
) -> Stage:
    """Open a view of a kind of page and greet it."""
    page = browser.new_context(**{"viewport": {"width": 1280, "height": 720}, **context}).new_page()
    stage = Stage(page, served, hello or {})
    serve_files(page, stage)

    def receive(data: str | bytes) -> None:
        if isinstance(data, str):
            stage.said.append(json.loads(data))
            messages.parse_text(data, served.further)  # a page says only what is specified
        else:
            stage.hands.append(messages.parse_binary(data))

    def connect(socket: WebSocketRoute) -> None:
        socket.on_message(receive)
        stage.sockets.append(socket)
        greet(stage, view)

    page.route_web_socket(f"{ORIGIN.replace('http', 'ws')}/socket/{view}?token=t", connect)
    page.goto(f"{ORIGIN}/{view}?token=t")
    stage.until(lambda: stage.text("#link-state") in ("Connected", "Ready"))
    return stage


def greet(stage: Stage, view: View) -> None:
    """Send what the server sends first."""
    hand = {"source": "page", "speed_m_per_s": 0.06, "delay_ms": 50, "repeat_ms": 100}
    hello: dict[str, Any] = {"version": 1, "view": view, "messages_per_s": 60, "hand": hand, **stage.hello}
    tissues: list[dict[str, Any]] = [{"rest_m": each["rest_m"]} for each in TISSUES]
    if view == "watch":
        hello |= {
            "rate_hz": 1000, "axes": 1, "device": "sim", "largest_n": 4.6,
            "master": "m", "hapticnet": "0", "history_s": 5.0,
            "columns": messages.COLUMNS, "limits": messages.LIMITS,
            "adjustable": ["multiplier", "codec", "loss_percent"],
            "codecs": [{"name": "deadband", "summary": "d"}, {"name": "raw", "summary": "r"}],
            "operator_url": f"{ORIGIN}/operator?token=o",
        }  # fmt: skip
        tissues = TISSUES
    stage.tell("hello", **hello)
    name = {"name": "paper:1"} if view == "watch" else {}
    stage.tell("scene", known=True, range_m=[0.0, 0.085], tissues=tissues, axes=1, reach_m=0.05, **name)
    stage.tell("hand", holder="nobody", state="free")
    stage.tell("ready", ready=True)
    if view == "watch":
        stage.tell("state", **STATE)
    stage.show(0.0, (0.02, 0.04), (0, 0))


def begin_again(stage: Stage, view: View) -> None:
    """Make an open page as good as new, which is faster than to open another."""
    stage.page.mouse.up()
    greet(stage, view)
    stage.page.evaluate("document.activeElement.blur()")
    for kept in (stage.said, stage.hands, stage.errors):
        kept.clear()
    del stage.sockets[:-1]
