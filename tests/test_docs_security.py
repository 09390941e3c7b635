"""tests/attacks/README.md names a test for each attack of docs/understand/security.md, and each of them exists."""

import re
from pathlib import Path

from tests.ready import hapticnet

ROOT = Path(__file__).parents[1]
DOCUMENT = (ROOT / "docs" / "understand" / "security.md").read_text()
TESTS = (ROOT / "tests" / "attacks" / "README.md").read_text()
ROW = re.compile(r"^\| (\d+) \| (.*) \|$", re.MULTILINE)


def test_the_attacks_are_numbered_and_each_has_one_row_of_tests():
    attacks = [int(number) for number, _ in ROW.findall(DOCUMENT)]
    tests = [int(number) for number, _ in ROW.findall(TESTS)]
    assert attacks == list(range(1, len(attacks) + 1))
    assert tests == attacks


def test_every_test_named_exists():
    tests = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    named = re.findall(r"`(test_\w+)`", TESTS)
    assert named
    assert [name for name in named if f"def {name}(" not in tests] == []
    assert "| – |" not in TESTS


def test_every_link_inside_the_page_leads_to_a_section():
    sections = {
        re.sub(r"[^\w -]", "", title).lower().replace(" ", "-")
        for title in re.findall(r"^#+ (.*)$", DOCUMENT, re.MULTILINE)
    }
    assert [link for link in re.findall(r"\]\(#([^)]+)\)", DOCUMENT) if link not in sections] == []


def test_every_command_shown_has_the_verbs_and_options_it_shows():
    commands = re.findall(r"^    hapticnet (.*?)(?:\s+#.*)?$", DOCUMENT, re.MULTILINE)
    assert len(commands) >= 5
    for command in commands:
        words = command.split()
        verb = [word for word in words[:2] if re.fullmatch("[a-z]+", word)]
        done = hapticnet(*verb, "--help")
        assert done.returncode == 0, command
        for option in re.findall(r"(--[a-z-]+)", command):
            assert option in done.stdout, command
