"""What the README shows runs as it stands there."""

import re
import tomllib
from pathlib import Path

from hapticnet.channel.presets import PRESETS
from hapticnet.scene.config import parse_scene

README = (Path(__file__).parents[1] / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_python_example_runs(capsys):
    (example,) = blocks("python")
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102 - our own README
    assert "packet" in capsys.readouterr().out


def test_the_scene_example_is_a_scene():
    (example,) = blocks("toml")
    scene = parse_scene(example, "README.md")
    assert [tissue.name for tissue in scene.tissues] == ["skin", "muscle"]
    declared = {key for tissue in tomllib.loads(example)["tissue"] for key in tissue}
    assert "recovery_time_s" in declared


def test_every_file_the_documents_link_to_is_there():
    root = Path(__file__).parents[1]
    documents = [root / "README.md", root / "CONTRIBUTING.md", *sorted((root / "docs").rglob("*.md"))]
    for document in documents:
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", document.read_text()):
            assert link.startswith("http") or (document.parent / link).exists(), f"{document.name} links to {link}"


def test_the_table_of_channel_presets_is_the_one_in_the_code():
    text = (Path(__file__).parents[1] / "docs" / "channel.md").read_text()
    for name, preset in PRESETS.items():
        assert f"| {name} | `{preset.settings.describe()}` |" in text
