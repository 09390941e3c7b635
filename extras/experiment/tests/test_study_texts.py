"""What participants read: its file, and how it is shown in a terminal."""

import asyncio
import os
import re
from pathlib import Path
from textwrap import fill

import pytest

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.errors import HapticnetError
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.web.server import static_files
from hapticnet_experiment.fronts import TerminalFront, in_lines
from hapticnet_experiment.page import ParticipantPage
from hapticnet_experiment.plan import Plan, find_plan
from hapticnet_experiment.screens import Screen, ScreenKind, Screens, english, shipped
from tests.cli.test_cli_errors import ROOT


def plan_with(folder: Path, texts: str, plan: str = 'texts = "own.toml"\n') -> Plan:
    (folder / "own.toml").write_text(texts)
    (folder / "plan.toml").write_text(plan)
    return find_plan(str(folder / "plan.toml"))


def test_a_study_has_its_own_texts_beside_its_plan(tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    plan = plan_with(tmp_path, shipped().replace('consent = "Consent"', 'consent = "Einwilligung"'))
    assert Screens(plan.texts).make(ScreenKind.CONSENT, "consent", text="").title == "Einwilligung"
    assert plan.digest() != Plan().digest()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("risk = .*\n", "", "consent.risk is missing"),
        ("risk = .*\n", 'risk = " "\n', "consent.risk is ' '"),
        ("undo =", "undone =", "unknown key 'screens.undone' (did you mean 'undo'?)"),
        ("trials = .*\n", 'trials = "{done} trials"\n', "screens.trials must have {all} and {done}"),
        ("undo = .*\n", 'undo = "undo {"\n', "screens.undo must have no words in braces"),
    ],
)
def test_texts_with_a_mistake_are_refused_in_one_line(tmp_path, old, new, told):
    texts, count = re.subn(old, new, shipped(), count=1)
    assert count == 1
    with pytest.raises(HapticnetError) as error:
        plan_with(tmp_path, texts)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("consent", ["", "none, because ", "You will feel forces"])
def test_a_study_without_consent_needs_a_reason_and_texts_a_file(tmp_path, consent):
    with pytest.raises(HapticnetError, match=r"texts 'xx' is not a \.toml file; write one with"):
        plan_with(tmp_path, "", 'texts = "xx"\n')
    with pytest.raises(HapticnetError, match=r'consent is .*; it must be "ask"'):
        plan_with(tmp_path, "", f'consent = "{consent}"\n')


def test_the_consent_states_the_forces_of_the_safety_page():
    page = (ROOT / "docs/understand/safety.md").read_text()
    table = page[page.index("## Forces at the finger") :].split("\n## ")[0]
    stated = re.findall(r"[0-9.]+ N\b", english().consent["risk"])
    assert len(stated) == 3
    assert [each for each in stated if f"**{each}**" not in table] == []
    reached_n = MAX_FORCE_N - ForceControlSettings().headroom_n
    assert f"**{reached_n:g} N**" in table
    assert float(stated[0].removesuffix(" N")) >= reached_n


def test_every_text_of_the_page_is_used_and_every_one_that_is_used_is_there():
    given = set(english().for_page())
    served = static_files(ParticipantPage.packages)
    files = {name: body.decode() for name, (body, _) in served.items() if name.endswith((".js", ".html"))}
    code = "".join(text for name, text in files.items() if "vendor" not in name)
    used = set(re.findall(r"\btexts\.(\w+)", code)) | set(re.findall(r'data-(?:text|label|title)="(\w+)"', code))
    computed = {"front", "middle", "back", "enter", "escape", "backspace", "language"}
    own = set(re.findall(r"^  (\w+): ", files["texts.js"], re.MULTILINE))
    assert used - {"js"} <= given | own
    assert given <= used | computed


def test_a_screen_in_a_terminal_breaks_no_word():
    lines = in_lines(Screens(english()).make(ScreenKind.CONSENT, "consent", text=english().agreement), english(), 0)
    for width in (40, 80):
        text = "\n".join(fill(line, width) for line in lines)
        assert max(map(len, text.splitlines())) <= width
        assert text.split() == "\n".join(lines).split()


def test_a_terminal_tells_how_long_a_break_lasts():
    screen = Screens(english()).make(ScreenKind.BREAK, "pause", "go_on", not_before_us=60_000_000)
    assert "  Enter: go on, in 45 s at the earliest" in in_lines(screen, english(), 15_000_000)
    assert "  Enter: go on" in in_lines(screen, english(), 60_000_000)


def test_a_key_pressed_before_a_question_is_shown_does_not_answer_it():
    class Shown:
        activity = None

        def __init__(self, title: str) -> None:
            self.screen = Screen(kind=ScreenKind.FEEDBACK, title=title, text="", keys=(("enter", "go on"),))

    async def scenario() -> None:
        keys, terminal = os.openpty()
        with TerminalFront(english(), terminal) as front:
            await front.show(Shown("one"))
            os.write(keys, b"\r\r")
            assert await front.key(Shown("one")) == "enter"
            waiting = asyncio.ensure_future(front.key(Shown("two")))
            await asyncio.sleep(0.1)
            assert not waiting.done()
            os.write(keys, b"\r")
            assert await asyncio.wait_for(waiting, 2.0) == "enter"
        os.close(keys)
        os.close(terminal)

    asyncio.run(scenario())
