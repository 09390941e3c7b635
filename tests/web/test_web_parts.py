"""The parts of the page's server that need no running master."""

import asyncio
import math
import re
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from hapticnet.errors import UnavailableError
from hapticnet.perception import WeberLaw
from hapticnet.protocol.stats import Distribution
from hapticnet.protocol.wire import Kind
from hapticnet.runtime.udp import HostPort
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene
from hapticnet.web.access import DEFAULT, Access, listen_for_pages
from hapticnet.web.audience import Audience
from hapticnet.web.client import LARGEST_BACKLOG, LONGEST_QUEUE, MOST_MESSAGES_PER_S, Client
from hapticnet.web.mirror import Mirror, scene_called
from hapticnet.web.server import static_files
from hapticnet.web.ticks import Ticks
from hapticnet.web.traffic import RecentMedian, TrafficMeter
from tests.web.rig import played, read_samples


def thrust(to_m: float) -> list[float]:
    return [*np.linspace(0.0, to_m, 500).tolist(), *np.linspace(to_m, 0.0, 500).tolist()]


def test_a_mirror_feels_what_the_scene_feels():
    settings = find_scene("paper:4")
    scene, path_m = Scene(settings.tissues), thrust(0.075)
    felt = [scene.step(PositionSample(1000 * n, (x,))).force_n[0] for n, x in enumerate(path_m)]
    assert Mirror(settings, is_new=True).forces_n(range(0, 1000 * len(path_m), 1000), path_m) == felt


def test_the_force_of_a_scene_that_was_used_before_is_unknown_until_the_needle_was_outside():
    mirror = Mirror(find_scene("paper:4"), is_new=False)
    forces = mirror.forces_n(range(4), [0.03, 0.025, 0.0199, 0.025])
    assert [math.isnan(force) for force in forces] == [True, True, False, False]


def test_savings_count_only_while_a_force_is_felt():
    received = SimpleNamespace(packets=0, wire_bytes=0, lost=0, by_kind={})
    sent = SimpleNamespace(packets=0, wire_bytes=0, by_kind={Kind.POSITION: 0})
    drawing = SimpleNamespace(packets=0, wire_bytes=0)
    session = SimpleNamespace(received=received, drawing=drawing, sent=sent, sealed=False)
    meter = TrafficMeter(SimpleNamespace(session=session, axes=1))  # type: ignore[arg-type]
    for felt, packets in ((False, 1), (True, 50), (False, 1)):
        sent.by_kind[Kind.POSITION] += 1000
        received.packets += packets
        feedback = meter.report(1.0, felt=felt)["feedback"]
    assert (feedback["packets"], feedback["raw_packets"]) == (50, 1000)
    assert meter.arrived == 52


def test_the_range_of_the_needle_tells_nothing_about_the_tissues():
    ranges = {Mirror(find_scene(f"paper:{seed}"), is_new=True).range_m for seed in range(6)}
    assert len(ranges) == 1


@pytest.mark.parametrize("name", ["/etc/passwd.toml", "secret.toml", "my own", "paper:x", ""])
def test_a_name_from_the_network_opens_no_file(name: str):
    assert scene_called(name) is None


class Node(SimpleNamespace):
    """What `Ticks` reads of a master."""

    def __init__(self, axes: int = 1) -> None:
        zero = (0.0,) * axes
        received = SimpleNamespace(by_kind=[0] * 10)
        super().__init__(
            position_m=None, received_n=zero, held_n=zero, target_n=0.0, sensed_n=0.0, displacement_m=0.0,
            session=SimpleNamespace(received=received), first_axes=axes,
        )  # fmt: skip


def test_rows_are_numbered_without_gaps_and_timed_from_the_start():
    node = Node()
    ticks = Ticks(node, 1_000_000)
    ticks.add(1_000_500)  # before there is a position
    assert ticks.take(None) == []
    node.position_m = (0.5,)
    seen: list[tuple[int, float, np.ndarray]] = []
    for tick in range(40):
        node.held_n = (float(tick),)
        node.session.received.by_kind[5] += tick % 2
        ticks.add(1_000_000 + 1000 * tick)
        if tick % 17 == 0:
            seen += map(read_samples, ticks.take(None))
    seen += map(read_samples, ticks.take(None))
    assert [first for first, _, _ in seen] == [0, 1, 18, 35]
    rows = np.concatenate([block for _, _, block in seen], axis=1)
    times = np.concatenate([start_s + block[0] for _, start_s, block in seen])
    assert times == pytest.approx(np.arange(40) * 1e-3)
    assert rows[4].tolist() == list(range(40))
    assert rows[8].tolist() == [tick % 2 for tick in range(40)]
    assert np.isnan(rows[2]).all()


def test_what_is_felt_is_that_of_the_newest_seconds():
    node, mirror = Node(), Mirror(find_scene("paper:4"), is_new=True)
    node.position_m = (0.0,)
    ticks = Ticks(node, 0)
    for second, held_n in enumerate((1.0, *[0.0] * 4, 1.0)):
        node.held_n = (held_n,)
        for tick in range(1000):
            ticks.add(1_000_000 * second + 1000 * tick)
        ticks.take(mirror)
    felt = ticks.felt(WeberLaw())
    assert felt is not None
    assert felt.exceed_jnd_fraction == pytest.approx(0.2, abs=1e-3)


def test_a_force_of_several_axes_is_shown_by_its_norm():
    node = Node(axes=3)
    node.position_m, node.held_n, node.received_n = (0.1, 0.2, 0.3), (1.0, 2.0, 2.0), (0.0, 3.0, 4.0)
    ticks = Ticks(node, 0)
    ticks.add(0)
    ((_, _, block),) = map(read_samples, ticks.take(None))
    assert block[1:5, 0] == pytest.approx([0.1, math.nan, 5.0, 3.0], nan_ok=True)


class Socket:
    """A socket of a page that does not read."""

    async def send_str(self, _: str) -> None:
        await asyncio.Event().wait()

    send_bytes = send_str


@played
async def test_a_page_that_does_not_read_is_left_out_and_one_that_says_too_much_is_not_admitted():
    transport = Mock(**{"get_write_buffer_size.return_value": 0})
    client = Client("watch", Socket(), transport)  # type: ignore[arg-type]
    for _ in range(1000):
        client.post_replaceable(bytes(1000))
    assert client.left_out > 700, "it fills no memory"
    await asyncio.sleep(0)  # one is being sent
    transport.get_write_buffer_size.return_value, before = LARGEST_BACKLOG - client._queued_bytes, client.left_out
    client.post_replaceable(b"x")
    assert client.left_out == before
    client.post_replaceable(b"x")
    assert client.left_out == before + 1
    assert len(client._queue) > LONGEST_QUEUE
    client.post("needed")
    transport.abort.assert_called()
    admitted = sum(client.admits() for _ in range(3 * MOST_MESSAGES_PER_S))
    assert MOST_MESSAGES_PER_S <= admitted <= 2 * MOST_MESSAGES_PER_S
    await client.finish()


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1:47880", True), ("127.0.0.1:9000", True), ("localhost:47880", True), ("[::1]:47880", True),
        ("192.168.1.7:47880", True), ("evil.example:47880", False), ("127.0.0.1.evil.example:47880", False),
        ("localhost.evil.example", False), ("", False), ("[::1", False),
    ],
)  # fmt: skip
def test_only_numbers_and_own_names_are_this_server(host: str, expected: bool):
    assert Access("127.0.0.1", 47880).is_ours(host) is expected


def test_without_an_address_another_port_is_taken_where_the_usual_one_is_in_use():
    one, _ = listen_for_pages(None)
    other, access = listen_for_pages(None)
    assert (access.host, access.port != DEFAULT.port) == ("127.0.0.1", True)
    with pytest.raises(UnavailableError, match=r"cannot serve the page at 127\.0\.0\.1:.* in use"):
        listen_for_pages(HostPort("127.0.0.1", access.port))
    one.close()
    other.close()


def assert_every_file_is_there(files: dict[str, tuple[bytes, str]]) -> None:
    for name, (body, _) in files.items():
        if name.endswith((".html", ".css", ".js")) and "vendor/" not in name:
            text = body.decode()
            named = re.findall(r'(?:src|href)="/?static/([^"]+)"', text) + re.findall(r'from "\./([^"]+)"', text)
            assert {each for each in named if each not in files} == set(), name
    assert {"watch.html", "operator.html"} <= files.keys()
    assert not re.search(rb"https?://(?!www\.w3\.org)", b"".join(files[n][0] for n in files if n.endswith(".html")))


def test_every_file_that_a_page_names_is_there():
    assert_every_file_is_there(static_files(Audience.packages))


def test_the_round_trip_is_that_of_the_last_second():
    median, distribution = RecentMedian(), Distribution()
    assert median.of(distribution, 0.0) is None
    for tick in range(20):
        for _ in range(100):
            distribution.add(400.0 if tick < 10 else 120_000.0)
        shown = median.of(distribution, 0.2 * (tick + 1))
        if tick == 9:
            assert shown == pytest.approx(400.0, rel=0.02)
    assert shown == pytest.approx(120_000.0, rel=0.02)
