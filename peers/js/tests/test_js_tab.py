"""A tab that is a master through a gateway: what it feels, what it tells nobody, and what it does when things end."""

import itertools
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tab_rig import SECRET, WITHIN_MS, Process, Rig, free_port, press, renderers, served, until

from hapticnet.protocol.key_files import write_key
from hapticnet.protocol.keys import PrivateKey, format_key
from hapticnet_gateway.cli import read_token

pytest.importorskip("playwright")
pytestmark = pytest.mark.browser
PHONE = {"width": 375, "height": 740}
SLEW_N_PER_S = 50.0
FASTEST_M_PER_S = 0.06
STEP_N = 0.3
"""The codec's own steps on the way down a tissue, between two ticks of a busy machine."""

SPRING = """
import {{ createSocket }} from "node:dgram";
import {{ Slave, onSocket, serve }} from "{index}";
const socket = createSocket("udp4");
socket.bind({port}, "127.0.0.1");
serve(new Slave({{ scene: "a spring" }}), onSocket(socket), ([x]) => [x > 0.01 ? 300 * (x - 0.01) : 0]);
"""


@pytest.fixture(scope="module")
def elsewhere(package: Path) -> Iterator[str]:
    with served(package / "dist") as origin:
        yield origin


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory, package: Path, elsewhere: str) -> Iterator[Rig]:
    made = Rig(tmp_path_factory.mktemp("rig"), package / "dist", elsewhere)
    yield made
    made.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    opened = browser.new_page(viewport=PHONE)
    opened.complaints = []
    opened.on("console", lambda said: opened.complaints.append(said.text))
    opened.on("pageerror", lambda error: opened.complaints.append(str(error)))
    yield opened
    opened.close()


def touching(page: Any) -> None:
    page.locator("#session[data-level=good]").wait_for(timeout=WITHIN_MS)


def feels(page: Any, at_least_n: float = 0.2) -> None:
    until(page, f"Number.parseFloat(force.textContent) > {at_least_n}")


def feels_nothing(page: Any) -> None:
    # The codec may keep a force below the smallest difference that is felt, 0.025 N, which the page rounds.
    until(page, "Number.parseFloat(force.textContent) <= 0.03")


def ticks(page: Any) -> list[list[float]]:
    found: list[list[float]] = page.evaluate("hapticnet.ticks.since(0)")
    return found


def never_jumps(rows: list[list[float]]) -> None:
    """Assert that the tool moved no faster than it may, and that a force that was lost came back slowly."""
    for (t, depth, force), (t_next, depth_next, force_next) in itertools.pairwise(rows):
        s = (t_next - t) / 1e6
        assert abs(depth_next - depth) <= FASTEST_M_PER_S * min(s, 0.02) + 1e-9
        if s > 1.0:  # longer than any force counts
            assert force_next == 0.0
        if force == 0.0 and depth > 0.021:
            assert force_next <= SLEW_N_PER_S * s + STEP_N


def test_a_tab_feels_a_sealed_slave_and_no_key_leaves_it(rig: Rig, page: Any):
    asked: list[str] = []
    page.on("request", lambda each: asked.append(f"{each.url} {each.headers} {each.post_data}"))
    page.goto(rig.address())
    touching(page)
    press(page, 26)
    feels(page)
    assert page.locator("#seal").inner_text() == "sealed"
    assert page.locator("#granted").inner_text().endswith("a second; the slave predicts your hand")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    page.locator("#trip").filter(has_text="ms").wait_for(timeout=WITHIN_MS)
    page.mouse.up()
    page.locator("#let-go").click()
    feels_nothing(page)
    assert page.complaints == []
    assert any("/offer" in each for each in asked)
    for each in asked:
        assert rig.fragment["key"] not in each
        assert rig.fragment["slave"] not in each
        assert rig.fragment["token"] not in each.partition(" ")[0]
    assert rig.slave.said("'tab'.* joined")


def test_a_page_served_elsewhere_connects_if_the_gateway_names_its_origin(rig: Rig, page: Any, elsewhere: str):
    page.goto(rig.address(f"{elsewhere}/page", gateway=rig.url))
    touching(page)
    page.locator("#scene").focus()
    for _ in range(5):
        page.keyboard.press("PageDown")
    feels(page)
    page.keyboard.press("Escape")
    feels_nothing(page)
    page.goto(rig.address(f"{elsewhere}/page".replace("127.0.0.1", "localhost"), gateway=rig.url))
    page.locator("#link", has_text="does not answer").wait_for(timeout=WITHIN_MS)


def test_a_wrong_token_is_told_once_and_not_tried_again(rig: Rig, page: Any):
    offers: list[str] = []
    page.on("request", lambda each: offers.append(each.url) if each.url.endswith("/offer") else None)
    page.goto(rig.address(token="wrong"))  # noqa: S106
    page.locator("#link[data-level=bad]", has_text="The token is missing or wrong.").wait_for(timeout=WITHIN_MS)
    time.sleep(1.5)
    assert len(offers) == 1


def test_a_page_without_keys_asks_for_them_or_makes_one(rig: Rig, page: Any):
    page.goto(f"{rig.url}/#token={rig.fragment['token']}&slave={rig.fragment['slave']}".replace("+", "%2B"))
    page.locator("button.primary").click()
    page.locator("#wrong", has_text="needs your private key").wait_for()
    page.locator("#make-key").click()
    assert "[[master]]" in page.locator("#entry").inner_text()
    page.locator("button.primary").click()
    page.locator("#session[data-level=bad]", has_text="key").wait_for(timeout=WITHIN_MS)


def test_a_slave_without_the_codec_is_asked_once_more_for_deadband(package: Path, tmp_path: Path, page: Any):
    """The package's own slave has neither that codec nor few positions."""
    port = str(free_port())
    program = SPRING.format(index=(package / "dist" / "index.js").as_uri(), port=port)
    with subprocess.Popen(["node", "--experimental-global-webcrypto", "--input-type=module", "-e", program]) as slave:
        write_key(tmp_path / "token.toml", SECRET)
        here = f"127.0.0.1:{free_port()}"
        arguments = ["--slave", f"127.0.0.1:{port}", "--listen", here, "--token", tmp_path / "token.toml"]
        gateway = Process("gateway", *arguments, folder=package / "dist")
        try:
            gateway.said("page:")
            page.goto(f"http://{here}/#token={read_token(tmp_path / 'token.toml')}&begin=1")
            touching(page)
            press(page, 15)
            feels(page)
            said = "the slave refuses motion-predictive: deadband is used; each position is sent"
            assert page.locator("#granted").inner_text() == said
        finally:
            gateway.stop()
            slave.terminate()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"axes": "2"}, "The slave refuses: the master has 2 axes"),
        ({"slave": "", "key": ""}, "The slave refuses: this slave serves sealed sessions only"),
        ({"slave": format_key(PrivateKey(bytes(32)).public)}, "the slave does not answer: does it run, and is this"),
    ],
    ids=["axes", "no keys", "another slave's key"],
)
def test_what_is_wrong_is_told_and_nothing_else_is_asked_for(rig: Rig, page: Any, wrong: dict[str, str], words: str):
    page.goto(rig.address(**wrong))
    page.locator("#session", has_text=words).wait_for(timeout=WITHIN_MS)
    assert page.locator("#granted").inner_text() == ""
    page.locator("#change").click()
    page.locator("button.primary").wait_for()
    assert page.locator("[name=token]").input_value() == rig.fragment["token"]


def test_a_wrong_key_is_told_at_the_form(rig: Rig, page: Any):
    page.goto(rig.address(key="abc"))
    page.locator("#wrong", has_text="keys.private has 3 characters").wait_for(timeout=WITHIN_MS)
    assert page.locator("#touching").is_hidden()


def test_a_slave_that_ends_in_contact_leaves_no_force_and_says_so(
    package: Path, elsewhere: str, tmp_path: Path, page: Any
):
    rig = Rig(tmp_path, package / "dist", elsewhere)
    try:
        page.goto(rig.address())
        touching(page)
        press(page, 26)
        feels(page)
        rig.slave.stop()
        page.locator("#session[data-level=wait]", has_text="no force; the slave says: ").wait_for(timeout=WITHIN_MS)
        until(page, "force.textContent === '0.00 N'")
    finally:
        rig.close()


def test_a_tab_that_sleeps_goes_to_no_force_and_wakes_without_a_jump(rig: Rig, page: Any):
    page.goto(rig.address())
    touching(page)
    press(page, 26)
    feels(page)
    found = renderers()
    assert found
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for pid in found:
            os.kill(pid, number)
        time.sleep(2.0 if number == signal.SIGSTOP else 0.0)
    feels(page)
    rows = ticks(page)
    assert max(later[0] - before[0] for before, later in itertools.pairwise(rows)) > 1.5e6
    never_jumps(rows)


def test_a_hidden_page_lets_go_and_keeps_its_pace(rig: Rig, page: Any):
    # As a browser does it with a hidden page: its timers, not those of its workers, wait for a second.
    page.add_init_script(
        "const wait = setTimeout; setTimeout = (f, ms, ...more) => wait(f, Math.max(1000, ms), ...more)"
    )
    page.goto(rig.address())
    touching(page)
    press(page, 26)
    feels(page)
    page.evaluate("""() => {
        Object.defineProperty(document, "hidden", { value: true });
        document.dispatchEvent(new Event("visibilitychange"));
    }""")
    until(page, "Number.parseFloat(force.textContent) <= 0.03")
    rows = ticks(page)
    assert rows[-1][1] < 0.02
    last_s = [row for row in rows if row[0] > rows[-1][0] - 1e6]
    assert len(last_s) > 50
    never_jumps(rows)


def test_a_session_goes_on_over_a_new_connection(rig: Rig, page: Any):
    page.goto(rig.address())
    touching(page)
    press(page, 26)
    feels(page)
    joined = len(rig.slave.said(" joined"))
    for connections in (2, 3):
        page.evaluate("dispatchEvent(new Event('online'))")
        until(page, f"hapticnet.link.carried.connections === {connections}")
    feels(page)
    before = page.evaluate("hapticnet.link.carried.received")
    until(page, f"hapticnet.link.carried.received > {before} + 20")
    assert len(rig.slave.said(" joined")) == joined
    never_jumps(ticks(page))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL], ids=["ended", "killed"])
def test_a_gateway_that_comes_back_is_found_and_the_force_rises_slowly(rig: Rig, page: Any, number: int):
    page.goto(rig.address())
    touching(page)
    press(page, 26)
    feels(page)
    rig.gateway.stop(number)
    page.locator("#link", has_text="trying again").wait_for(timeout=WITHIN_MS)
    page.locator("#force", has_text=re.compile(r"^0\.00 N$")).wait_for(timeout=WITHIN_MS)  # it fades for 0.3 s
    rig.start_gateway()
    page.locator("#link[data-level=good]").wait_for(timeout=WITHIN_MS)
    feels(page)
    assert "Traceback" not in "".join(rig.gateway.lines)
    never_jumps(ticks(page))
