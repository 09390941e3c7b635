"""The verb ``hapticnet experiment``: its help, its options, and what it refuses before it begins."""

import re

import pytest
import typer

from hapticnet.cli.settings import leaves, option_key
from hapticnet_experiment.cli import EXAMPLES, app
from tests.cli.test_cli_errors import assert_only_line
from tests.cli.test_cli_help import COMMANDS, not_taken
from tests.cli.test_cli_options import kind
from tests.ready import ROOT

VERBS = dict(leaves(typer.main.get_command(app), ("experiment",)))
PAGES = [(ROOT / "extras" / "experiment" / name).read_text() for name in ("README.md", "observers.md")]
SHOWN = [line for page in PAGES for line in re.findall(r"(?:^ *|`)(hapticnet experiment [a-z][^`\n]*)", page, re.M)]
NEEDED = {"limits": ("--participant", "03"), "order": ("--participant", "03"), "analyse": ("study",)}
OPTIONS = [
    (verb, option_key(each))
    for verb, command in VERBS.items()
    for each in command.params
    if each.param_type_name == "option" and kind(each) != "flag"
]


@pytest.mark.parametrize("verb", EXAMPLES, ids=" ".join)
def test_the_help_has_every_option_and_the_examples(run, verb):
    shown = run(*verb, "--help").stdout
    assert [line.strip() for line in shown.partition("Examples:\n")[2].splitlines()] == list(EXAMPLES[verb])
    options = (
        {option_key(each) for each in VERBS[verb].params if each.param_type_name == "option"}
        if verb in VERBS
        else set()
    )
    assert set(re.findall(r"^  (?:-\w, )?--(?:\[no-\])?([a-z-]+)", shown, re.M)) == {*options, "help"}


def test_every_command_of_the_examples_and_of_the_documents_can_be_parsed():
    theirs = [line for line in COMMANDS if "hapticnet experiment" in line]
    assert theirs, "the README of hapticnet shows it"
    lines = [*theirs, *(line for lines in EXAMPLES.values() for line in lines)]
    assert len(SHOWN) > 8
    lines += SHOWN
    for line in lines:
        assert not_taken(line, VERBS) == [], line


@pytest.mark.parametrize(("verb", "name"), OPTIONS, ids=lambda each: each if isinstance(each, str) else each[1])
def test_an_empty_value_is_refused(run, verb, name):
    done = run(*verb, *NEEDED[verb[1]], f"--{name}=")
    assert_only_line(done, "it is empty; give ", code=2)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("order", "--page", "--simulate", "literature"), "--page is for a person"),
        (("order", "--operator", "page"), "--operator page needs --page"),
        (("order", "--page=8080"), "must be HOST:PORT"),
    ],
)
def test_a_page_of_the_experiment_that_makes_no_sense_is_told_in_one_line(run, tmp_path, arguments, complaint):
    done = run("experiment", *arguments, "--participant", "01", "--out-dir", tmp_path)
    assert_only_line(done, complaint, code=2)
