"""What the views show and say, with a test in place of the server."""

import math

import pytest

pytest.importorskip("playwright")
from hapticnet.operator.live import HandState
from hapticnet.web import messages
from hapticnet.web.messages import CloseCode
from tests.web.staged import ORIGIN, STATE, Stage, begin_again, open_view


@pytest.fixture(scope="module")
def opened(chromium):
    stages = {view: open_view(chromium, view) for view in ("watch", "operator")}
    yield stages
    for stage in stages.values():
        stage.page.context.close()


@pytest.fixture
def watch(opened):
    begin_again(opened["watch"], "watch")
    yield opened["watch"]
    assert opened["watch"].errors == []
    assert all(url.startswith(ORIGIN) for url in opened["watch"].requests)


@pytest.fixture
def operator(opened):
    begin_again(opened["operator"], "operator")
    yield opened["operator"]
    assert opened["operator"].errors == []


def take(stage: Stage) -> None:
    """Give the page the hand when it asks for it."""
    stage.until(lambda: bool(stage.heard("take")))
    stage.tell("hand", holder="you", state="live")


def test_a_drag_takes_the_hand_and_moves_the_needle_as_far_as_the_pointer(operator: Stage):
    box = operator.page.locator("#scene").bounding_box()
    x, y = box["x"] + 200, box["y"] + 100
    operator.page.mouse.move(x, y)
    operator.page.mouse.down()
    take(operator)
    operator.until(lambda: bool(operator.hands))
    operator.page.mouse.move(x, y + 100, steps=5)
    shown_m = 0.085 + 0.002 + 0.014  # the range, and what is shown around it
    operator.until(lambda: abs(operator.hands[-1].position_m[0] - 100 * shown_m / box["height"]) < 1e-4)
    operator.page.mouse.up()
    heard = len(operator.hands)
    operator.until(lambda: len(operator.hands) > heard + 3)  # a hand that rests is not silent
    assert operator.page.locator("#plot, #settings, .tile, #sound").count() == 0, "no force and no setting is shown"
    assert operator.hands[-1].position_m[0] == operator.hands[heard].position_m[0]


def test_the_hand_stays_within_the_range_and_turns_back_at_once(operator: Stage):
    operator.page.keyboard.press("PageDown")
    take(operator)
    for _ in range(30):
        operator.page.keyboard.press("PageDown")
    operator.until(lambda: bool(operator.hands) and abs(operator.hands[-1].position_m[0] - 0.085) < 1e-6)
    operator.page.keyboard.press("PageUp")
    operator.until(lambda: abs(operator.hands[-1].position_m[0] - 0.080) < 1e-6)


def test_an_arrow_key_moves_the_needle_while_it_is_down(operator: Stage):
    operator.page.keyboard.down("ArrowDown")
    take(operator)
    operator.until(lambda: bool(operator.hands) and operator.hands[-1].position_m[0] > 0.01)
    operator.page.keyboard.up("ArrowDown")
    operator.page.keyboard.press("Escape")
    operator.until(lambda: bool(operator.heard("release")))


def test_the_energy_is_shown_where_the_force_can_move_the_hand(watch: Stage):
    watch.tell("state", **STATE)
    assert not watch.page.locator("#tile-energy").is_visible()
    port = {"put_in_j": 1.5, "given_back_j": 1.75, "created_j": 0.25, "swings": True}
    watch.tell("state", **STATE, port=port)
    watch.until(lambda: watch.page.locator("#tile-energy").is_visible())
    shown = " ".join(watch.text("#tile-energy").split())
    assert shown == "Energy created 250 mJ 1.50 J put in 1.75 J given back The hand swings"
    assert "The hand swings" in watch.text("#notice")
    watch.tell("state", **STATE, port=port | {"swings": False})
    watch.until(lambda: "swings" not in watch.text("#tile-energy") and not watch.page.locator("#notice").is_visible())


def test_a_page_that_lost_the_hand_sends_nothing_until_it_is_pressed_again(operator: Stage):
    operator.page.mouse.move(400, 300)
    operator.page.mouse.down()
    take(operator)
    operator.until(lambda: bool(operator.hands))
    operator.tell("hand", holder="nobody", state="withdrawing")
    operator.until(lambda: "withdrawn" in operator.text("#hand-state"))
    heard = len(operator.hands)
    operator.page.mouse.move(400, 400, steps=5)
    operator.page.wait_for_timeout(150)
    assert len(operator.hands) == heard
    assert len(operator.heard("take")) == 1


def test_while_another_page_has_the_hand_this_one_watches(operator: Stage):
    operator.tell("hand", holder="another", state="live")
    operator.until(lambda: operator.text("#hand-state") == "Another page moves the needle")
    operator.page.mouse.click(400, 300)
    operator.until(lambda: "Another page" in operator.text("#notice"))
    assert operator.heard("take") == []
    assert operator.page.locator("#hand-button").is_disabled()


def test_a_watcher_stops_another_page_only_with_a_button_that_says_so(watch: Stage):
    watch.tell("hand", holder="another", state="live")
    watch.until(lambda: watch.text("#hand-state") == "Another page moves the needle")
    watch.page.keyboard.press("Escape")
    assert watch.page.get_by_role("button", name="Let go").count() == 0
    assert watch.heard("let_go") == []
    watch.page.get_by_role("button", name="Stop the other page").click()
    watch.until(lambda: bool(watch.heard("let_go")))


def test_a_force_that_the_device_cannot_give_is_told(watch: Stage):
    watch.tell("hand", holder="you", state="live")
    watch.show(0.03, (0.03, 0.04), (1, 0))
    for force_n, told in ((4.0, False), (45.0, True), (4.0, False)):
        watch.send_samples(held=force_n, true=force_n, received=force_n)
        watch.tell("state", **STATE)
        watch.until(lambda told=told: watch.page.locator("#notice").is_visible() == told)
        if told:
            assert "The device presses with 4.6 N at most" in watch.text("#notice")


def test_an_event_is_news_for_a_while_only_and_text_and_never_markup(watch: Stage):
    watch.tell("event", t_s=100.0, text="<img src=x onerror=alert(1)>")
    watch.tell("state", **STATE | {"t_s": 110.0})
    watch.until(lambda: watch.text("#newest") == "<img src=x onerror=alert(1)>")
    watch.tell("state", **STATE | {"t_s": 121.0})
    watch.until(lambda: watch.text("#newest") == "")
    watch.page.get_by_role("button", name="All events").click()
    assert "onerror" in watch.text("#event-list")
    assert watch.page.locator("#event-list img").count() == 0
    watch.page.keyboard.press("Escape")


def test_a_hidden_page_gives_the_hand_back(operator: Stage):
    operator.page.keyboard.press("ArrowDown")
    take(operator)
    hide = "Object.defineProperty(document, 'hidden', { value: %s, configurable: true });"
    operator.page.evaluate(hide % "true" + "document.dispatchEvent(new Event('visibilitychange'))")
    operator.until(lambda: bool(operator.heard("release")))
    operator.page.evaluate(hide % "false")


def test_a_breach_is_told_to_screen_readers(watch: Stage):
    watch.show(0.025, (0.025, 0.04), (1, 0))
    watch.show(0.031, (0.02, 0.04), (2, 0))
    watch.until(lambda: watch.text("#announcer") == "skin breached")
    needle = watch.page.get_by_role("slider", name="Needle")
    watch.until(lambda: (needle.get_attribute("aria-valuetext") or "").startswith("31 millimetres deep, skin breached"))


def test_forces_and_traffic_are_shown_in_numbers(watch: Stage):
    for _ in range(5):
        watch.send_samples(held=1.5, received=1.5, true=1.52, sensed=1.4)
    watch.until(lambda: watch.text("[data-line=held] output") == "1.50 N")
    assert watch.text("[data-line=true] output") == "1.52 N"
    assert watch.text("[data-line=band] output") == "±75 mN"
    assert watch.text("#tile-packets .big") == "21 /s"
    assert "of 1,000" in watch.text("#tile-packets")
    assert watch.text("#tile-saved .big") == "97.0 %"


def test_a_paused_plot_stands_still(watch: Stage):
    watch.send_samples(held=1.0)
    watch.until(lambda: watch.text("[data-line=held] output") == "1.00 N")
    watch.page.get_by_role("button", name="Pause").click()
    watch.page.mouse.move(5, 5)
    before = watch.page.locator("#plot").screenshot()
    for _ in range(3):
        watch.send_samples(held=2.0)
        watch.page.wait_for_timeout(50)
    assert watch.page.locator("#plot").screenshot() == before
    watch.page.get_by_role("button", name="Pause").click()


def test_a_setting_is_sent_and_a_refused_one_is_shown_as_it_was(watch: Stage):
    slider = watch.page.get_by_label("Threshold")
    slider.focus()
    slider.press("ArrowRight")
    watch.until(lambda: bool(watch.heard("set")))
    assert watch.heard("set") == [{"type": "set", "multiplier": 1.25}]
    watch.tell("error", message="multiplier cannot be changed in this run")
    watch.until(lambda: slider.input_value() == "1")
    assert "Multiplier cannot be changed" in watch.text("#notice")
    assert watch.page.get_by_label("Delay each way").is_disabled(), "it is not among those that are adjustable"
    assert watch.page.get_by_label("Codec").is_enabled()


def test_a_stale_link_is_told(watch: Stage):
    watch.tell("state", **{**STATE, "link": "stale"})
    watch.tell("ready", ready=False)
    watch.until(lambda: watch.text("#link-state") == "Link stale")
    assert "The slave does not answer" in watch.text("#notice")


def test_messages_that_are_not_known_change_nothing(watch: Stage):
    for nonsense in ("{", "[]", '{"type": 3}', '{"type": "future", "x": 1}', b"", b"\x09" * 40, b"\x01\x00\xff\xff"):
        watch.sockets[-1].send(nonsense)
    watch.tell("event", t_s=1.0, text="still there")
    watch.until(lambda: "still there" in watch.text("#newest"))


def test_a_lost_connection_is_opened_again(watch: Stage):
    watch.sockets[-1].close(code=1001, reason="")
    watch.until(lambda: "Connection to the master lost" in watch.text("#notice"))
    watch.until(lambda: len(watch.sockets) == 2 and watch.text("#link-state") == "Connected")


def test_a_page_that_the_server_sent_away_comes_back_only_when_asked(watch: Stage):
    watch.sockets[-1].close(code=CloseCode.MASTER_ENDED, reason="the master ended")
    watch.until(lambda: "The master ended." in watch.text("#notice"))
    watch.page.wait_for_timeout(700)
    assert len(watch.sockets) == 1
    assert watch.page.locator("[data-offline] .tiles").count() == 1, "figures that are out of date look so"
    watch.page.get_by_role("button", name="Try again").click()
    watch.until(lambda: len(watch.sockets) == 2 and watch.text("#link-state") == "Connected")
    assert watch.page.locator("[data-offline]").count() == 0


def test_everything_is_reached_by_the_tab_key(watch: Stage):
    watch.page.locator("#sound").focus()
    reached = ["sound"]
    for _ in range(17):
        watch.page.keyboard.press("Tab")
        reached.append(watch.page.evaluate("document.activeElement.id || document.activeElement.dataset.line || ''"))
    expected = "sound operator-link scene hand-button true held sensed band pause multiplier codec loss_percent"
    assert [each for each in reached if each in expected.split()][:12] == expected.split()


@pytest.mark.parametrize("size", [(1280, 720), (390, 844), (320, 640)])
def test_nothing_is_wider_than_the_window(chromium, size):
    width, height = size
    stage = open_view(chromium, "watch", viewport={"width": width, "height": height})
    wide, high = stage.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    assert wide <= width
    if width == 1280:
        assert high <= height
    stage.page.context.close()


def test_the_theme_follows_the_system(chromium):
    stage = open_view(chromium, "operator", color_scheme="dark")
    theme = "document.documentElement.dataset.theme"
    assert stage.page.evaluate(theme) == "dark"
    stage.page.emulate_media(color_scheme="light")
    stage.until(lambda: stage.page.evaluate(theme) == "light")
    stage.page.context.close()


SHAPES = {
    0: ["plane", [0.02, 0, 0], [], [1, 0, 0], [0, 1, 0]],
    1: ["sphere", [0.034, 0.004, 0], [0.012], [1, 0, 0], [0, 1, 0]],
    2: ["box", [0.05, -0.02, 0.01], [0.005, 0.01, 0.01], [1, 0, 0], [0, 1, 0]],
    3: ["capsule", [0.01, 0.02, 0], [0.002, 0.01], [0, 0, 1], [1, 0, 0]],
}


def show_space(stage: Stage, axes: int = 3, *, described: bool = True) -> None:
    """Let the scene be one that is no tissue."""
    stage.tell("scene", known=False, range_m=[0.0, 0.1], tissues=[], axes=axes, reach_m=0.05, name="bench")
    if described:
        stage.tell("shapes", count=len(SHAPES), changed=SHAPES)
    show_push(stage, axes)


def show_push(stage: Stage, axes: int = 3, force_n: float = 0.0) -> None:
    further = (*[0.01] * (axes - 1), *[force_n] * axes) if axes > 1 else ()
    stage.sockets[-1].send(messages.frame(HandState.LIVE, 1, 0.0, 0.01, (), (), further))


def picture(stage: Stage) -> bytes:
    stage.page.wait_for_timeout(60)
    return stage.page.locator("#scene").screenshot()


def test_a_scene_that_describes_itself_is_drawn_and_named_in_the_first_sentence(watch: Stage):
    show_space(watch, described=False)
    watch.until(lambda: "does not say how it looks" in watch.text("#first"))
    bare = picture(watch)
    show_space(watch)
    watch.until(lambda: "among a plane, a sphere, a box and a capsule" in watch.text("#first"))
    watch.until(lambda: picture(watch) != bare)
    assert watch.text("#hand-state") == "The tool is free: drag it"
    assert not watch.page.locator("[data-line=true]").is_visible(), "nobody here knows the true force"
    tool = watch.page.get_by_role("slider", name="Tool")
    watch.until(lambda: (tool.get_attribute("aria-valuetext") or "").startswith("Tool at 10, 10, 10 millimetres"))
    begin_again(watch, "watch")
    watch.until(lambda: "2 layers of tissue" in watch.text("#first"))


def test_three_axes_are_moved_by_keys_pointer_and_wheel(watch: Stage):
    show_space(watch)
    watch.page.locator("#scene").focus()
    moved: list[int] = []
    for key in ("ArrowDown", "ArrowRight", "w"):
        watch.page.keyboard.down(key)
        if not moved:
            take(watch)
        axis = len(moved)
        watch.until(lambda axis=axis: bool(watch.hands) and watch.hands[-1].position_m[axis] > 0.012)
        watch.page.keyboard.up(key)
        moved.append(axis)
    before = watch.hands[-1].position_m
    box = watch.page.locator("#scene").bounding_box()
    watch.page.mouse.move(box["x"] + 100, box["y"] + 100)
    watch.page.mouse.down()
    watch.page.mouse.move(box["x"] + 130, box["y"] + 160, steps=3)
    watch.page.mouse.wheel(0, 200)
    watch.until(lambda: all(a > b for a, b in zip(watch.hands[-1].position_m[:2], before, strict=False)))
    watch.until(lambda: watch.hands[-1].position_m[2] < before[2] - 0.005)
    watch.page.mouse.up()
    right_m, down_m = (watch.hands[-1].position_m[axis] - before[axis] for axis in (1, 0))
    assert down_m == pytest.approx(2 * right_m, rel=0.05)


def test_a_second_finger_moves_away_and_back(watch: Stage):
    show_space(watch)
    watch.page.evaluate(
        """() => {
          const scene = document.getElementById("scene");
          scene.setPointerCapture = () => {};
          window.touch = (type, pointerId, x, y) => scene.dispatchEvent(
            new PointerEvent(type, { pointerId, clientX: x, clientY: y, pointerType: "touch", bubbles: true }));
          touch("pointerdown", 1, 100, 300);
        }"""
    )
    take(watch)
    watch.page.evaluate("touch('pointerdown', 2, 200, 300); touch('pointermove', 1, 100, 200)")
    watch.page.evaluate("touch('pointermove', 2, 200, 200)")
    watch.until(lambda: bool(watch.hands) and watch.hands[-1].position_m[2] > 0.012)
    assert watch.hands[-1].position_m[:2] == pytest.approx((0.01, 0.01)), "the first finger rests meanwhile"
    watch.page.evaluate("touch('pointerup', 2, 200, 200); touch('pointermove', 1, 100, 260)")
    watch.until(lambda: watch.hands[-1].position_m[0] > 0.012)
    watch.page.evaluate("touch('pointerup', 1, 100, 260); delete document.getElementById('scene').setPointerCapture")


def test_keys_scroll_a_page_that_is_longer_than_the_window_until_the_scene_has_them(chromium):
    stage = open_view(chromium, "watch", viewport={"width": 390, "height": 700})
    stage.page.keyboard.press("PageDown")
    stage.until(lambda: stage.page.evaluate("scrollY") > 100)
    assert stage.heard("take") == []
    stage.page.locator("#scene").focus()
    stage.page.keyboard.press("PageDown")
    stage.until(lambda: bool(stage.heard("take")))
    stage.page.context.close()


def test_a_force_of_any_size_is_drawn_inside_the_picture(watch: Stage):
    show_space(watch)
    code = """async ([from, push, size]) => {
      const { drawForce } = await import("/static/marks.js");
      const points = [];
      const context = new Proxy({}, { get: (_, name) => name === "measureText" ? () => ({ width: 90 })
        : (...all) => points.push([name, ...all]), set: () => true });
      drawForce(context, from, push, Math.hypot(push.x, push.y), size);
      return points;
    }"""
    size = {"width": 500, "height": 400}
    pushes = ({"x": 0, "y": -45}, {"x": 300, "y": 20}, {"x": -5, "y": 900}, {"x": -1, "y": -1}, {"x": -0.0, "y": -4})
    for push in pushes:
        drawn = watch.page.evaluate(code, [{"x": 480, "y": 390}, push, size])
        ((_, words, x, y),) = [each for each in drawn if each[0] == "fillText"]
        assert 0 < x < 500 - 80
        assert 0 < y < 400
        assert words.endswith("not to scale") == (max(map(abs, push.values())) > 4), words


def test_a_stick_moves_the_hand_and_the_rumble_follows_the_law_only_while_it_is_on(watch: Stage):
    watch.page.evaluate(
        """() => {
          window.played = [];
          const vibrationActuator = {
            playEffect: async (kind, { strongMagnitude }) => { played.push([kind, strongMagnitude]); },
            reset: async () => { played.push(["reset", 0]); },
          };
          const buttons = [{ pressed: false }, { pressed: false }];
          window.pad = { connected: true, axes: [0, 0, 0, 0], buttons, vibrationActuator };
          navigator.getGamepads = () => [null, pad];
        }"""
    )
    watch.tell("state", **STATE)
    button = watch.page.get_by_role("button", name="Rumble")
    watch.until(button.is_visible)
    watch.send_samples(held=2.0)
    watch.page.wait_for_timeout(200)
    assert watch.page.evaluate("played") == []
    button.click()
    assert "not its direction" in watch.text("#notice")
    watch.until(lambda: len(watch.page.evaluate("played")) > 2)
    kind, strength = watch.page.evaluate("played.at(-1)")
    assert (kind, strength) == ("dual-rumble", pytest.approx(math.log(1 + 2 / 0.5) / math.log(1 + 4.6 / 0.5)))
    watch.send_samples(held=90.0)
    watch.until(lambda: watch.page.evaluate("played.at(-1)[1]") == 1)
    watch.send_samples(held=0.02)
    watch.until(lambda: watch.page.evaluate("played.at(-1)[0]") == "reset")
    watch.page.evaluate("pad.buttons[0].pressed = true")
    take(watch)
    watch.page.evaluate("pad.axes[1] = 1")
    watch.until(lambda: bool(watch.hands) and watch.hands[-1].position_m[0] > 0.005)
    watch.page.evaluate("pad.buttons[1].pressed = true")
    watch.until(lambda: bool(watch.heard("release")))
    button.click()
    watch.page.evaluate("delete navigator.getGamepads")


def test_a_phone_vibrates_for_a_share_of_the_time_once_it_is_turned_on(chromium):
    stage = open_view(chromium, "watch", viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    stage.page.evaluate("() => { window.shaken = []; navigator.vibrate = (ms) => shaken.push(ms); }")
    stage.tell("state", **STATE)
    button = stage.page.get_by_role("button", name="Vibrate")
    stage.until(button.is_visible)
    stage.send_samples(held=4.6)
    stage.page.wait_for_timeout(150)
    assert stage.page.evaluate("shaken") == []
    button.click()
    stage.until(lambda: 100 in stage.page.evaluate("shaken"))
    button.click()
    stage.until(lambda: stage.page.evaluate("shaken.at(-1)") == 0)
    stage.page.context.close()
