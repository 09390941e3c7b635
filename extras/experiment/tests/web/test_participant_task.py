"""The screens of an experiment on the page, with a test in place of the server."""

from itertools import pairwise
from typing import Any

import pytest

pytest.importorskip("playwright")
from hapticnet_experiment.page import ParticipantPage
from hapticnet_experiment.screens import english
from tests.web.staged import TISSUES, Stage, begin_again, greet, open_view

STOP = {"key": "escape", "does": "stop: the force goes to zero at once"}
END = {"key": "escape", "does": "end the session"}
NEXT = [{"key": "enter", "does": "go on"}, END]
CHOICES = [{"key": key, "does": f"tissue {key}"} for key in "123"]
HELLO = {"experiment": {"masking_noise": False, "texts": english().for_page()}}


class Task:
    """A page in an experiment."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.page = stage.page
        self._number = 0

    def show(self, screen: str, *, keys: list[dict[str, str]], again: bool = False, **content: Any) -> None:
        self._number += not again
        about = {"title": f"{screen} {self._number}", "text": "Read this.", "typed": "", "remark": "", "progress": ""}
        content = {**about, "wait_s": 0.0, **content}
        self.stage.tell("task", number=self._number, screen=screen, keys=keys, **content)
        self.stage.until(lambda: self.page.locator("#task h2").inner_text() == content["title"])

    def heard(self) -> list[tuple[int, str]]:
        """Return what was pressed since the last call, without the present number."""
        self.page.wait_for_timeout(50)
        pressed = [each["key"] for each in self.stage.heard("key") if each["number"] == self._number]
        self.stage.said.clear()
        return pressed

    def focus(self) -> str:
        return str(self.page.evaluate("document.activeElement.id || document.activeElement.tagName"))


@pytest.fixture(scope="module")
def open_task(chromium):
    stage = open_view(chromium, "operator", ParticipantPage, HELLO)
    yield Task(stage)
    stage.page.context.close()


@pytest.fixture
def task(open_task):
    begin_again(open_task.stage, "operator")
    yield open_task
    assert open_task.stage.errors == []


def test_a_screen_is_answered_by_key_or_click_and_the_scene_is_not_shown(task: Task):
    task.show("instructions", keys=NEXT)
    assert not task.page.locator("#scene").is_visible()
    assert task.focus() == "H2"
    task.page.keyboard.press("x")
    task.page.keyboard.press("Enter")
    assert task.heard() == ["enter"]
    task.show("question", keys=[{"key": "1", "does": "the first"}, {"key": "2", "does": "the second"}, END])
    task.page.get_by_role("button", name="The second").click()
    task.page.keyboard.press("1")
    task.page.keyboard.press("Numpad2")
    assert task.heard() == ["2", "1", "2"]


def test_a_key_on_a_focused_button_presses_that_button_only(task: Task):
    task.show("consent", keys=[{"key": "y", "does": "I agree"}, {"key": "n", "does": "I do not agree"}])
    task.page.keyboard.press("Tab")
    task.page.keyboard.press("Tab")
    task.page.keyboard.press("Enter")
    assert task.heard() == ["n"]


def test_a_trial_shows_the_scene_and_the_answer_so_far(task: Task):
    task.show("trial", keys=[*CHOICES, STOP], progress="3 of 40 trials")
    assert task.page.locator("#scene").is_visible()
    assert task.focus() == "scene"
    assert "3 of 40 trials" in task.stage.text("#task")
    task.page.get_by_role("button", name="Tissue 2").click()
    task.show("trial", keys=[CHOICES[0], CHOICES[2], STOP], typed="2", title="typed", again=True)
    assert task.stage.text(".slots").split() == ["2", "–", "–"]
    assert task.page.get_by_role("button", name="Tissue 2").is_disabled()
    assert task.page.get_by_role("button", name="Confirm").is_disabled()
    assert task.stage.text("#announcer") == "Your answer: 2"
    assert task.heard() == ["2"]


def test_arrow_keys_move_the_needle_after_an_answer_was_clicked(task: Task):
    task.show("trial", keys=[*CHOICES, STOP])
    task.page.get_by_role("button", name="Tissue 2").click()
    task.page.keyboard.press("ArrowDown")
    task.stage.until(lambda: bool(task.stage.heard("take")))


def test_escape_stops_a_trial_at_once_but_asks_before_it_ends_the_session(task: Task):
    task.show("trial", keys=[*CHOICES, STOP])
    task.page.keyboard.press("Escape")
    assert task.heard() == ["escape"]
    task.show("feedback", keys=NEXT)
    task.page.keyboard.press("Escape")
    task.page.get_by_role("dialog", name="End the session?").wait_for()
    task.page.keyboard.press("Enter")  # stays
    assert task.heard() == []
    task.page.keyboard.press("Escape")
    task.page.get_by_role("dialog").get_by_role("button", name="End the session").click()
    assert task.heard() == ["escape"]


def test_a_break_counts_down_and_lets_nobody_on_before(task: Task):
    task.show("break", keys=NEXT, wait_s=0.6)
    button = task.page.get_by_role("button", name="Go on")
    assert button.inner_text().startswith("Go on in 1 s")
    task.page.keyboard.press("Enter")
    assert task.heard() == []
    task.stage.until(button.is_enabled)
    task.page.keyboard.press("Enter")
    assert task.heard() == ["enter"]


def test_a_rating_takes_one_of_seven(task: Task):
    task.show("rating", keys=[{"key": key, "does": ""} for key in "1234567"] + [END])
    task.page.get_by_role("group", name="Rating").get_by_role("button", name="5").click()
    task.page.keyboard.press("8")
    task.page.keyboard.press("7")
    assert task.heard() == ["5", "7"]


def test_what_was_wrong_with_a_key_is_shown_and_told_to_screen_readers(task: Task):
    task.show("trial", keys=[*CHOICES, STOP], typed="213")
    task.show("trial", keys=[*CHOICES, STOP], typed="213", title="again", again=True, remark="Not yet.")
    assert task.stage.text("#task .text") == "Not yet."
    assert task.stage.text("#announcer") == "Not yet."


def test_all_tissues_look_the_same_and_say_nothing_of_how_they_feel(task: Task):
    """The scene is the same picture whatever order its tissues have; each has the same pixels beside its number."""
    rests_m = (0.02, 0.04, 0.06)
    task.stage.tell(
        "scene", known=True, range_m=[0.0, 0.085], tissues=[{"rest_m": rest, "name": ""} for rest in rests_m]
    )
    task.show("trial", keys=[*CHOICES, STOP])
    task.stage.show(0.0, rests_m, (0, 0, 0))
    task.page.wait_for_timeout(100)
    colours = task.page.evaluate(
        """(rests) => {
          const canvas = document.getElementById("scene");
          const [low, high] = [-0.014, 0.087];
          const y = (m) => Math.round(((m - low) / (high - low)) * canvas.height);
          const context = canvas.getContext("2d");
          return rests.map((m) => [...context.getImageData(20, y(m + 0.003), 1, 1).data]);
        }""",
        rests_m,
    )
    for colour in colours[1:]:
        assert colour == pytest.approx(colours[0], abs=6)


def test_text_is_never_markup(task: Task):
    task.show("feedback", keys=NEXT, title="<img src=x onerror=alert(1)>", text="<b>bold</b>")
    assert task.page.locator("#task img, #task .text b").count() == 0


def test_masking_noise_is_off_until_it_is_switched_on_and_its_level_is_told(task: Task):
    task.show("instructions", keys=NEXT)
    button = task.page.get_by_role("button", name="Masking noise")
    assert button.get_attribute("aria-pressed") == "false"
    assert task.stage.heard("noise") == []
    button.click()
    task.page.get_by_role("slider", name="Level of the masking noise").press("ArrowRight")
    button.click()
    task.stage.until(lambda: len(task.stage.heard("noise")) == 3)
    assert [each["level"] for each in task.stage.heard("noise")] == [0.2, 0.22, 0]


def test_the_noise_is_white_and_not_clipped(task: Task):
    samples = task.page.evaluate(
        "async () => { const { gaussian } = await import('/static/noise.js'); return [...gaussian(20000)]; }"
    )
    mean = sum(samples) / len(samples)
    neighbours = sum(one * two for one, two in pairwise(samples)) / len(samples)
    variance = sum(each**2 for each in samples) / len(samples)
    assert abs(mean) < 0.01
    assert abs(variance - 0.0625) < 0.005
    assert abs(neighbours / variance) < 0.04
    assert max(map(abs, samples)) <= 1.0


def test_noise_that_the_plan_asks_for_begins_with_the_first_press(chromium):
    hello = {"experiment": HELLO["experiment"] | {"masking_noise": True}}
    stage = open_view(chromium, "operator", ParticipantPage, hello)
    task = Task(stage)
    task.show("instructions", keys=NEXT)
    assert stage.heard("noise") == []
    task.page.keyboard.press("Enter")
    stage.until(lambda: stage.heard("noise") == [{"type": "noise", "level": 0.2}])
    stage.page.context.close()


def test_the_end_stays_on_the_page_when_the_server_has_gone(task: Task):
    task.show("done", keys=[], title="Thank you")
    task.stage.sockets[-1].close(code=4410, reason="the session has ended")
    task.stage.until(lambda: task.stage.text("#link-state") == "Finished")
    assert not task.page.locator("#notice").is_visible()
    assert task.page.get_by_role("heading", name="Thank you").is_visible()
    task.page.reload()
    task.stage.until(lambda: len(task.stage.sockets) == 2)
    greet(task.stage, "operator")


def test_a_page_that_waits_for_long_says_what_to_do(chromium):
    stage = open_view(chromium, "operator", ParticipantPage, HELLO)
    task = Task(stage)
    task.show("instructions", keys=NEXT)
    stage.page.clock.install()
    stage.page.route_web_socket("**/socket/**", lambda socket: socket.close(code=1001, reason=""))
    stage.sockets[-1].close(code=1001, reason="")
    stage.until(lambda: "There is no force at your finger" in stage.text("#notice"))
    assert "lost" in stage.text("#notice")
    assert stage.page.locator("#notice").is_visible()
    stage.page.clock.run_for(16_000)
    stage.until(lambda: "tell the experimenter" in stage.text("#notice"))
    stage.page.context.close()


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (390, 844), (320, 640)])
def test_everything_fits_and_every_button_is_large_enough(task: Task, width: int, height: int):
    task.page.set_viewport_size({"width": width, "height": height})
    tissues = [{"rest_m": each["rest_m"], "name": "tissue 1"} for each in TISSUES]
    task.stage.tell("scene", known=True, range_m=[0.0, 0.085], tissues=tissues)
    for screen, keys in (("trial", [*CHOICES, STOP]), ("rating", [{"key": key, "does": ""} for key in "1234567"])):
        task.show(screen, keys=keys, progress="3 of 40 trials", remark=english().screens["untouched"])
        wide, high = task.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
        assert wide <= width
        if height > 700:
            assert high <= height
        for button in task.page.locator("#task button").all():
            box = button.bounding_box()
            assert box is not None
            assert min(box["width"], box["height"]) >= 32
    task.page.set_viewport_size({"width": 1280, "height": 720})
