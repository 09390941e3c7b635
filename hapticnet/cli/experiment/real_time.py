"""The ordering task in real time: with a slave here or on another host, and a person or a simulated observer."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticnet.cli.experiment import common
from hapticnet.cli.experiment.page import OpenedPage, make_screen

if TYPE_CHECKING:
    from hapticnet.device.profile import Profile
    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.runtime.udp import HostPort
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.recordings import RecordingForm
    from hapticnet.study.session import SessionSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where hand and slave are."""

    operator: str | None
    page: OpenedPage | None
    connect: str | None
    key: Path | None
    peer_key: str | None
    insecure: bool


def run_order(
    settings: "SessionSettings",
    known: "Profile",
    observer: "ObserverSettings | None",
    place: Place,
    *,
    form: "RecordingForm",
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Conduct the ordering task and return its account."""
    from hapticnet.cli.operators import make_operator
    from hapticnet.runtime.system import now_us
    from hapticnet.study.real_rig import Body, RealRig
    from hapticnet.study.recordings import record_trials
    from hapticnet.study.session import account_of, order_session

    source = place.operator or ("udp:47810" if place.page is None else "page")
    hand = None
    if observer is None:
        warn = lambda line: say(f"warning: {line}")  # noqa: E731
        hand = make_operator(source, insertions=1, seed=settings.seed, say=say, warn=warn)
    screen = None
    if place.page is not None and hand is not None:
        screen = make_screen(place.page, hand.operator, source.partition(":")[0], settings.plan)
    with (
        common.real_fingertip(settings.device, known, settings.seed) as (fingertip, wire),
        _slave(place) as (address, master_settings),
        order_session(settings, now_us()) as (flow, store),
    ):
        body = Body(
            fingertip=fingertip,
            wire=wire,
            hand=screen.hand if screen is not None else None if hand is None else hand.operator,
            hand_watchers=(*(() if hand is None else hand.watchers), *(() if screen is None else screen.watchers)),
        )
        rig = RealRig(body, master_settings, address, tell=say)
        about = {"operator": source if observer is None else "scripted", "connect": str(address)}
        keep = record_trials(settings, form, about)
        common.run_session(common.conduct_in_real_time(rig, flow, store, settings, observer, screen, keep))
        return account_of(settings, flow)


@contextmanager
def _slave(place: Place) -> "Iterator[tuple[HostPort, MasterSettings]]":
    """Yield the address of the slave and the settings of masters; start a slave if none is named."""
    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.runtime.processes import Child
    from hapticnet.runtime.trust import master_key
    from hapticnet.runtime.udp import is_loopback, open_toward, parse_host_port
    from hapticnet.study.scene import SCENE_SPEC

    if place.connect is not None:
        address = parse_host_port(place.connect)
        sock, slave = open_toward(address)
        sock.close()
        key = master_key(address, is_loopback(slave), place.key, place.peer_key, place.insecure)
        yield address, MasterSettings(key=key)
        return
    child = Child(["slave", "--listen", "127.0.0.1:0", "--scene", SCENE_SPEC])
    try:
        yield parse_host_port(child.address()), MasterSettings()
    finally:
        child.end()
