import json
import re
from pathlib import Path

import pytest
from plan import BENCHMARKS

pytestmark = pytest.mark.timeout(400)  # every benchmark is run, on a machine that may be busy
HEADLINE = ("<!-- headline: written by make bench -->", "<!-- end of headline -->")
NOT_SHOWN = ("doors", "hostile_slave", "peers")  # quoted in sentences of other pages
REPORT = Path(__file__).parents[2] / "bench" / "report"
SPEED = {"name": "speed", "results": {"codecs": [{"codec": "slow", "ratio": 0.25}, {"codec": "fast", "ratio": 0.75}]}}
CLAIM = """
{% set worst = speed.codecs | map(attribute="ratio") | min %}
{% claim worst >= LIMIT %}
Every codec reaches half the speed of C,
the slowest {{ worst | pct }}.
{% endclaim %}
"""


@pytest.fixture
def write(bench, tmp_path):
    """Return how to write a page from a template and targets, and the folder of the pages."""

    def run(template, *arguments, targets="target = []", records=(SPEED,)):
        for folder in ("results", "templates", "docs"):
            (tmp_path / folder).mkdir(exist_ok=True)
        for record in records:
            (tmp_path / "results" / f"{record['name']}.json").write_text(json.dumps(record))
        (tmp_path / "templates" / "page.md.in").write_text(template)
        (tmp_path / "templates" / "targets.toml").write_text(targets)
        folders = (tmp_path / "results", "--templates", tmp_path / "templates", "--out", tmp_path / "docs")
        return bench("report/pages.py", *folders, *(arguments or ["--draft"]))

    return run


def test_a_claim_that_holds_passes(write):
    done = write(CLAIM.replace("LIMIT", "0.25"), "--check")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_claim_that_fails_is_named_with_its_sentence_and_the_value_seen(write, tmp_path):
    for arguments in ((), ("--check",)):
        done = write(CLAIM.replace("LIMIT", "0.5"), *arguments)
        assert done.returncode == 1
        assert done.stderr.splitlines()[0] == (
            "page.md.in:3: the claim 'worst >= 0.5' does not hold (seen: 0.25):"
            " Every codec reaches half the speed of C, the slowest 25%."
        )
    assert not list((tmp_path / "docs").iterdir())


@pytest.mark.parametrize(
    ("template", "message"),
    [
        ("\n{{ speed.nothing }}", "page.md.in:2: 'dict object' has no attribute 'nothing'"),
        ("{{ missing.rows }}", "page.md.in:1: 'missing' is undefined"),
        ("{{ (speed.codecs | one(codec='none')).ratio }}", "page.md.in:1: 0 rows instead of 1 with {'codec': 'none'}"),
        ("\n\n{% claim 1 < 2 %}", "page.md.in:3: Unexpected end of template"),
        ("{{ speed.codecs | one(name='slow') }}", "page.md.in:1: the row has no 'name'"),
    ],
)
def test_a_figure_that_the_results_do_not_have_ends_in_one_line(write, template, message):
    done = write(template)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {message}")
    assert done.stderr.count("\n") == 1


def test_one_page_is_written_alone(write, tmp_path):
    assert write("{{ missing }}").returncode == 1
    (tmp_path / "templates" / "other.md.in").write_text("{{ speed.codecs | length }} codecs")
    done = write("{{ missing }}", "--only", "other.md", targets="not read")
    assert (done.returncode, done.stderr) == (0, "")
    assert [(path.name, path.read_text()) for path in (tmp_path / "docs").iterdir()] == [("other.md", "2 codecs")]


@pytest.mark.parametrize(
    ("records", "reason"),
    [
        ([SPEED | {"revision": "a1"}, SPEED | {"name": "felt", "revision": "b2"}], "the results are of a1, b2;"),
        ([SPEED | {"revision": "a1-dirty"}], "the results are of a1-dirty; all should be of one commit"),
        ([{"name": "real_time", "revision": "a1", "cores_of_others": 0.5, "results": {}}], "real_time: other programs"),
    ],
)
def test_results_of_several_revisions_or_of_a_busy_machine_are_not_published(write, tmp_path, records, reason):
    done = write("here", "--out", tmp_path / "pages", records=records)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {reason}")
    assert not (tmp_path / "pages").exists()


@pytest.mark.parametrize("name", ["other", "peers"])
def test_a_page_that_needs_more_is_made_only_where_its_record_is(write, tmp_path, name):
    (tmp_path / "templates").mkdir()
    (tmp_path / "templates" / "peers.md.in").write_text("{% claim 1 > 2 %}made{% endclaim %}")
    done = write("here", "--check", records=[SPEED, {"name": name, "results": {}}])
    assert ("made" in done.stderr) is (name == "peers")


TARGETS = """
[[target]]
each = "speed.codecs"
what = "{{ row.codec }} over C"
value = "row.ratio"
limit = ">= 0.5"
show = "{:.0%}"

[[target]]
row = "speed.codecs | largest('ratio')"
what = "any"
value = "none"
limit = "<= 200"
show = "{:.0f} ms"
at = "row.codec"
"""


def test_targets_are_reached_where_their_figures_are(write):
    template = "{% claim targets | map(attribute='measured') | list == [] %}x{% endclaim %}"
    assert "['25%', '75%', 'never']" in write(template, "--check", targets=TARGETS).stderr
    template = "{% claim targets | map(attribute='reached') | list == [false, true, false] %}x{% endclaim %}"
    assert write(template, "--check", targets=TARGETS).returncode == 0
    template = "{% claim targets | map(attribute='at') | list == ['', '', 'fast'] %}x{% endclaim %}"
    assert write(template, "--check", targets=TARGETS).returncode == 0


def test_a_mistake_in_the_targets_is_named(write):
    done = write("", targets=TARGETS.replace("row.ratio", "row.speed"))
    assert done.returncode == 1
    assert done.stderr.startswith("error: targets.toml, '{{ row.codec }} over C': 'dict object' has no attribute")


@pytest.fixture(scope="module")
def records(measured, folder):
    """Return the record of every benchmark, from quick runs."""
    for each in BENCHMARKS:
        if each.name not in NOT_SHOWN:
            measured(each.name)
    return {
        file.stem: json.loads(file.read_text()) for file in folder.glob("*.json") if file.stem not in ("doors", "peers")
    }


@pytest.fixture(scope="module")
def pages(records):
    """Return the pages; what they claim need not hold for quick runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(REPORT)
        import pages

        return pages.render(REPORT, records)[0]


def test_every_placeholder_of_the_pages_has_its_figure(pages):
    assert set(pages) == {"felt.md", "headline.md", "index.md", "tables.md"}
    for text in pages.values():
        assert not re.search(r"{{|{%|\bnan\b|None|Undefined", text)


def test_the_readme_has_the_headline_of_its_template(pages):
    readme = (REPORT.parents[1] / "README.md").read_text().partition(HEADLINE[0] + "\n")[2].partition(HEADLINE[1])[0]
    without_figures = (re.sub(r"\d[\d.,]*", "0", text) for text in (readme, pages["headline.md"]))
    assert len(set(without_figures)) == 1


def test_every_table_is_whole(pages):
    blocks = [
        block.splitlines() for text in pages.values() for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    ]
    assert len(blocks) > 25
    for block in blocks:
        assert len(block) > 2
        assert len({line.count("|") for line in block}) == 1


def test_the_first_page_opens_with_one_screen(pages):
    first = pages["index.md"].partition("\n## ")[0]
    assert first.count("\n") < 40
    assert first.count("![") == 1


def test_pages_and_every_picture_they_show_are_written(write, pages, records, tmp_path):
    done = write(pages["index.md"], records=records.values())
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "docs" / "page.md").read_text() == pages["index.md"]
    shown = {name for text in pages.values() for name in re.findall(r"!\[[^]]*\]\(figures/([^)]+)\)", text)}
    drawn = {path.name: path.read_bytes() for path in (tmp_path / "docs" / "figures").iterdir()}
    assert shown == set(drawn)
    assert all(content.startswith(b"\x89PNG") for content in drawn.values())
