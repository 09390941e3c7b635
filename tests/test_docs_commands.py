"""What docs and messages say to install can be installed: hapticnet is in no index, so only from its checkout."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
REQUIRED = [*PROJECT["dependencies"], *(each for extra in EXTRAS.values() for each in extra)]
PACKAGES = {re.split(r"[<>=\[;]", each)[0] for each in REQUIRED} - {"hapticnet"}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "bench/report").glob("*.in"))]
SOURCES = sorted((ROOT / "hapticnet").rglob("*.py"))
COMMAND = re.compile(r"pip install ([^`\n#|;\")]+)")
ELSEWHERE = {"mujoco", "pandas"}
"""Packages that a page or a message names although hapticnet does not need them."""


def targets(text: str) -> list[str]:
    """Return what each command of pip in a text installs, without its options."""
    words = [word.strip("'\"") for command in COMMAND.findall(text) for word in command.split()]
    return [word for word in words if word and not word.startswith("-")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_installs_from_the_checkout_or_what_an_index_has(page: Path):
    for target in targets(page.read_text()):
        local = re.fullmatch(r"\.(?:\[([\w,]+)\])?", target)
        if (ROOT / target).is_file():  # a lock
            continue
        if local is None:
            assert target in PACKAGES | ELSEWHERE, f"pip install {target}"
        else:
            assert set((local[1] or "").split(",")) <= {"", *EXTRAS}, f"pip install {target}"


def test_a_message_names_packages_that_an_index_has():
    found = {target for source in SOURCES for target in targets(source.read_text())}
    assert found, "there are such messages"
    assert {target for target in found if not target.startswith("{")} <= PACKAGES | ELSEWHERE


def test_nothing_names_a_distribution_that_is_in_no_index():
    for path in (*PAGES, *SOURCES):
        assert "hapticnet[" not in path.read_text(), path


def test_each_extra_that_a_page_names_exists():
    for page in PAGES:
        for names in re.findall(r"[Ee]xtras? `(\w+)`", page.read_text()):
            assert names in EXTRAS, f"{page.name}: {names}"
