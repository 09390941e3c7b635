"""What the README shows runs as it stands there."""

import json
import re
import tomllib

from hapticnet.channel.spec import PRESETS
from hapticnet.scene.sources import parse_scene
from tests.ready import ROOT, hapticnet

README = (ROOT / "README.md").read_text()


def blocks(language, text):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_the_python_example_runs(capsys):
    (example,) = blocks("python", README)
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102 - our own README
    assert "packet" in capsys.readouterr().out


def test_the_scene_example_is_a_scene():
    example = blocks("toml", (ROOT / "docs" / "use" / "scenes.md").read_text())[0]
    scene = parse_scene(example, "scenes.md")
    assert [tissue.name for tissue in scene.tissues] == ["skin", "muscle"]
    declared = {key for tissue in tomllib.loads(example)["tissue"] for key in tissue}
    assert "recovery_time_s" in declared


def test_every_file_the_documents_link_to_is_there():
    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    for document in documents:
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", document.read_text()):
            assert link.startswith("http") or (document.parent / link).exists(), f"{document.name} links to {link}"


def test_the_readme_is_short():
    assert README.count("\n") <= 160


def test_the_last_links_name_every_page_once():
    links = re.findall(r"\]\(([^)#]+)\)", README.partition("## Read on")[2])
    assert len(links) == len(set(links))
    pages = {str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md")}
    assert pages - {"docs/benchmarks/tables.md"} <= set(links)


def test_compare_finds_on_the_papers_scene_what_the_readme_says():
    said = dict(re.findall(r"`(deadband|adaptive-predictive)`\s(?:sends\s)?([\d.]+) times", README))
    assert len(said) == 2
    done = hapticnet("compare", "--multipliers", "1", "--codecs", ";".join(said), "--json")
    rows = json.loads(done.stdout)["rows"]
    assert {row["codec"]: f"{row['over_optimum']:.2f}" for row in rows} == said
    assert all(row["exceed_jnd_fraction"] == 0.0 for row in rows)


def test_the_table_of_channel_presets_is_the_one_in_the_code():
    text = (ROOT / "docs" / "understand" / "delay.md").read_text()
    for name, preset in PRESETS.items():
        assert f"| {name} | `{preset.settings.describe()}` |" in text
