import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


def bench(script, *arguments):
    folder = "report" if script.startswith(("page", "plot")) else "measure"
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, REPOSITORY / "bench" / folder / script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=100, check=True)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Return the page made of two quick benchmarks, the others not having been run."""
    folder = tmp_path_factory.mktemp("page")
    bench("rate_distortion.py", "--quick", "--json", folder / "rate_distortion.json")
    bench("scene_accuracy.py", "--quick", "--json", folder / "scene_accuracy.json")
    bench("page.py", folder, "--out", folder)
    return folder / "benchmarks.md"


def sections(page):
    parts = re.split(r"^## (.*)$", page.read_text(), flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def test_the_page_says_what_was_not_measured(page):
    found = sections(page)
    assert "Not measured (`bench/measure/force_loop.py`)." in found["The fingertip's force loop"]
    assert "Not measured" not in found["Packets over the best possible"]
    assert "`bench/measure/scene_accuracy.py`" in found["Set-up"]
    assert "force_loop" not in found["Set-up"]


def test_every_picture_of_the_page_is_there(page):
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text())
    assert {Path(picture).name for picture in pictures} == {
        "rate_distortion.png",
        "codec_cost.png",
        "scene_accuracy.png",
    }
    assert all((page.parent / picture).read_bytes().startswith(b"\x89PNG") for picture in pictures)


def test_every_table_of_the_page_is_whole(page):
    tables = [block.splitlines() for block in page.read_text().split("\n\n") if block.startswith("| ")]
    assert len(tables) > 8
    for table in tables:
        assert len(table) > 2
        assert len({line.count("|") for line in table}) == 1


def test_a_target_is_reached_where_its_figure_says_so(page):
    rows = [
        line.strip("| ").split(" | ")
        for line in sections(page)["Targets"].splitlines()
        if "over the optimal hold" in line
    ]
    assert rows
    for _, aim, measured, verdict in rows:
        assert aim == "≤ 1.0"
        if float(measured) != 1.0:  # which was rounded
            assert verdict == ("reached" if float(measured) < 1.0 else "**missed**")
