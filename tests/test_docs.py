"""What the README and the pages say is so: code and commands run; metrics, tests, links and packages exist."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from hapticnet.channel.spec import PRESETS
from hapticnet.cli import INTERNAL, INTERRUPTED, READER_GONE
from hapticnet.errors import FileError, RefusedError, SettingsError, UnavailableError
from hapticnet.runtime.metrics import TABLES
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
    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    documents += [*sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "extras").glob("*/*.md"))]
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
    for name, settings in PRESETS.items():
        assert f"| {name} | `{settings.describe()}` |" in text


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
REQUIRED = [*PROJECT["dependencies"], *(each for extra in EXTRAS.values() for each in extra)]
PACKAGES = {re.split(r"[<>=\[;]", each)[0] for each in REQUIRED} - {"hapticnet"}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "bench/report").glob("*.in"))]
SOURCES = sorted((ROOT / "hapticnet").rglob("*.py"))
COMMAND = re.compile(r"pip install ([^`\n#|;\")]+)")
ELSEWHERE = {"mujoco", "my-motor", "pandas"}
"""Packages that a page or a message names although hapticnet does not need them; one is the reader's own."""


def targets(text: str) -> list[str]:
    """Return what each command of pip in a text installs, without its options."""
    words = [word.strip("'\"") for command in COMMAND.findall(text) for word in command.split()]
    return [word for word in words if word and not word.startswith("-")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_installs_from_the_checkout_or_what_an_index_has(page: Path):
    for target in targets(page.read_text()):
        local = re.fullmatch(r"\.(?:\[([\w,]+)\])?", target)
        if local is None and (ROOT / target).exists():  # a lock, or a package of its own
            continue
        if local is None:
            assert target in PACKAGES | ELSEWHERE, f"pip install {target}"
        else:
            assert set((local[1] or "").split(",")) <= {"", *EXTRAS}, f"pip install {target}"


def test_a_message_names_packages_that_an_index_has():
    found = {target for source in SOURCES for target in targets(source.read_text())}
    assert found, "there are such messages"
    assert {target for target in found if "{" not in target} <= PACKAGES | ELSEWHERE


def test_nothing_names_a_distribution_that_is_in_no_index():
    for path in (*PAGES, *SOURCES):
        assert "hapticnet[" not in path.read_text(), path


def test_each_extra_that_a_page_names_exists():
    for page in PAGES:
        for names in re.findall(r"[Ee]xtras? `(\w+)`", page.read_text()):
            assert names in EXTRAS, f"{page.name}: {names}"


SERVICE = (ROOT / "docs/use/service.md").read_text()
METRICS = {metric.name: metric.kind for table in TABLES.values() for metric in table}
SUFFIXES = {"counter": ("_total",), "gauge": ("",), "histogram": ("_bucket", "_count", "_sum")}
NAMES = {f"hapticnet_{name}{suffix}" for name, kind in METRICS.items() for suffix in SUFFIXES[kind]}


def test_the_dashboard_shows_metrics_that_exist():
    dashboard = json.loads((ROOT / "docs/grafana.json").read_text())
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    used = set(re.findall(r"hapticnet_\w+", " ".join(expressions)))
    assert used <= NAMES
    shown = {name for name in METRICS if any(f"hapticnet_{name}" in each for each in used)}
    assert len(shown) >= 0.7 * len(METRICS)
    places = [tuple(panel["gridPos"].values()) for panel in dashboard["panels"]]
    assert len(set(places)) == len(places)
    assert all(x + width <= 24 for x, _, width, _ in places)


def test_the_page_lists_every_metric_and_no_other():
    section = SERVICE.partition("## Metrics")[2].partition("\n## ")[0]
    listed = set(re.findall(r"`(hapticnet_\w+)`", section))
    assert listed == {f"hapticnet_{name}{'_total' * (kind == 'counter')}" for name, kind in METRICS.items()} | {
        "hapticnet_info"
    }


def test_the_page_lists_the_exit_codes():
    listed = {int(code) for code in re.findall(r"^\| (\d+) \|", SERVICE, re.MULTILINE)}
    kinds = {error.exit_code for error in (SettingsError, FileError, UnavailableError, RefusedError)}
    assert listed == {0, 1, *kinds, INTERNAL, INTERRUPTED, READER_GONE, 143}


SECURITY = (ROOT / "docs/understand/security.md").read_text()
ATTACKS = (ROOT / "tests/attacks/README.md").read_text()
ROW = re.compile(r"^\| (\d+) \| (.*) \|$", re.MULTILINE)


def test_the_attacks_are_numbered_and_each_has_one_row_of_tests():
    attacks = [int(number) for number, _ in ROW.findall(SECURITY)]
    tests = [int(number) for number, _ in ROW.findall(ATTACKS)]
    assert attacks == list(range(1, len(attacks) + 1))
    assert tests == attacks


def test_every_test_and_file_named_exists():
    texts = {
        path.name: path.read_text()
        for path in [*(ROOT / "tests").rglob("test_*.py"), *(ROOT / "extras").rglob("test_*.py")]
    }
    attacks = re.findall(r"`(test_\w+)`", ATTACKS)
    assert [name for name in attacks if f"def {name}(" not in "".join(texts.values())] == []
    assert "| – |" not in ATTACKS
    hazards = re.findall(r"`(test_\w+\.py)::(test_\w+)`", (ROOT / "tests/firmware/README.md").read_text())
    assert min(len(attacks), len(hazards)) > 30
    assert [name for file, name in hazards if f"def {name}(" not in texts.get(file, "")] == []
    files = re.findall(r"`((?:hapticnet|firmware)/\S+\.\w+)`", (ROOT / "docs/understand/safety.md").read_text())
    assert [file for file in files if not (ROOT / file).is_file()] == []


def test_every_link_inside_the_page_leads_to_a_section():
    sections = {
        re.sub(r"[^\w -]", "", title).lower().replace(" ", "-")
        for title in re.findall(r"^#+ (.*)$", SECURITY, re.MULTILINE)
    }
    assert [link for link in re.findall(r"\]\(#([^)]+)\)", SECURITY) if link not in sections] == []


def test_every_command_shown_has_the_verbs_and_options_it_shows():
    commands = re.findall(r"^    hapticnet (.*?)(?:\s+#.*)?$", SECURITY, re.MULTILINE)
    assert len(commands) >= 5
    for command in commands:
        words = command.split()
        verb = [word for word in words[:2] if re.fullmatch("[a-z]+", word)]
        done = hapticnet(*verb, "--help")
        assert done.returncode == 0, command
        for option in re.findall(r"(--[a-z-]+)", command):
            assert option in done.stdout, command
