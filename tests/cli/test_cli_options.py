"""Options over all verbs: each is in a group of the help, and one name is one thing."""

import re

import pytest
import typer

from hapticnet.cli import app
from hapticnet.cli.settings import leaves, option_key
from hapticnet.cli.verbs import GROUPS
from tests.ready import ROOT

VERBS = dict(leaves(typer.main.get_command(app)))
OPTIONS = [
    (verb, each) for verb, command in VERBS.items() for each in command.params if each.param_type_name == "option"
]
OF_OTHERS = {"cases", "most-tabs", "origin", "servers", "slave-python", "nthreads", "simulate"}
"""Options of the benchmarks, of Dask and of extras/ that the documents name."""

NAMES = sorted({option_key(each) for _, each in OPTIONS})


def kind(option):
    """Return what a value of an option is, as a user sees it; two lists of choices are of one kind."""
    if option.is_flag:
        return "flag"
    return ("several " if option.multiple else "") + (option.metavar or "choice")


def test_every_option_is_in_one_group_and_every_name_of_a_group_is_an_option():
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted({*NAMES, "help"})


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_the_help_shows_each_option_in_its_group(run, verb):
    shown, group = {}, ""
    for line in run(*verb, "--help").stdout.splitlines():
        if heading := re.fullmatch(r"([A-Z].*):", line):
            group = heading[1]
        elif option := re.match(r"  (?:-\w, )?--(?:\[no-\])?([a-z-]+)", line):
            shown[option[1]] = group
    expected = {option_key(each) for owner, each in OPTIONS if owner == verb} | {"help"}
    assert shown == {name: group for group, names in GROUPS.items() for name in names if name in expected}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_has_one_kind_of_value_and_the_same_short_form_in_every_verb(name):
    options = [each for _, each in OPTIONS if option_key(each) == name]
    assert len({(kind(each), *each.opts) for each in options}) == 1


def test_every_flag_can_be_switched_on_and_off():
    for verb, each in OPTIONS:
        if each.is_flag:
            assert each.secondary_opts == [f"--no-{option_key(each)}"], verb


@pytest.mark.parametrize(("ending", "value"), [("-dir", "DIR"), ("-format", "choice"), ("-timeout", "SECONDS")])
def test_the_end_of_a_name_says_what_its_value_is(ending, value):
    assert {kind(each) for _, each in OPTIONS if option_key(each).endswith(ending)} == {value}


def test_the_documents_name_only_options_that_exist():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"`--([a-z-]+)", page.read_text())}
    assert named - OF_OTHERS <= {*NAMES, *(f"no-{option_key(each)}" for _, each in OPTIONS if each.is_flag)}


def test_a_value_is_a_folder_only_if_the_name_says_so():
    folders = {option_key(each) for _, each in OPTIONS if kind(each) == "DIR"}
    assert {name for name in folders if not name.endswith("-dir")} == set()
