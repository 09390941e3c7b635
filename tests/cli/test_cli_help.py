"""Each verb's help ends with examples that work, and the shell completes names and values."""

import itertools
import re
import shlex

import pytest

from hapticnet.cli import with_page_address
from hapticnet.cli.examples import EXAMPLES
from tests.cli.test_cli_options import VERBS
from tests.ready import ROOT, hapticnet

README = (ROOT / "README.md").read_text()
PAGES = [README, *(file.read_text() for file in sorted((ROOT / "docs").rglob("*.md")))]
BLOCKS = [
    block for page in PAGES for block in re.findall(r"^(?: {4}.*\n)+|^```(?:sh)?\n(?s:.*?)^```", page, re.MULTILINE)
]
SHOWN = [line for block in BLOCKS for line in re.findall(r"^ *((?:\w+=\S+ )?hapticnet [a-z].*)", block, re.MULTILINE)]
IN_TABLES = re.findall(r"`(hapticnet [^`]* --[^`]*)`", README)
COMMANDS = dict.fromkeys([*(line for lines in EXAMPLES.values() for line in lines), *SHOWN, *IN_TABLES])
OURS = [line for line in COMMANDS if not re.search("hapticnet (experiment|gateway)", line)]  # verbs of packages

GROUPS = {verb[:count] for verb in VERBS for count in range(len(verb))}


@pytest.mark.parametrize("verb", [*VERBS, *sorted(GROUPS)], ids=" ".join)
def test_every_verb_has_examples_which_its_help_shows(run, verb):
    done = run(*verb, "--help")
    assert done.returncode == 0
    assert not [line for line in done.stdout.splitlines()[1:] if line.endswith("...")], "a summary is cut short"
    shown = done.stdout.partition("Examples:\n")[2].splitlines()
    assert [line.strip() for line in shown] == list(EXAMPLES[verb])
    assert re.findall(r"--\S+ <(?:int|float|str|path)\b.*?>", done.stdout) == [], "a type instead of a value"


def not_taken(line, verbs):
    """Return the arguments of a command line that its verb does not take."""
    words = shlex.split(line, comments=True)
    words = list(itertools.takewhile(lambda word: not re.match(r"2?>|[|&]", word), words))
    words = with_page_address(words[words.index("hapticnet") + 1 :])
    if words[0] == "sweep" and words[1] not in ("run", "show"):
        words.insert(1, "run")
    count = next(count for count in (1, 2) if tuple(words[:count]) in verbs)
    command = verbs[tuple(words[:count])]
    return command.make_parser(command.context_class(command, **command.context_settings)).parse_args(words[count:])[1]


@pytest.mark.parametrize("line", OURS)
def test_every_command_of_the_examples_and_of_the_documents_can_be_parsed(line):
    assert not_taken(line, VERBS) == []


def test_there_are_examples_of_the_verbs_that_exist():
    assert set(EXAMPLES) == set(VERBS) | GROUPS


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("ma",), {"master"}),
        (("master", "--insec"), {"--insecure"}),
        (("master", "--positions", "l"), {"line"}),
        (("sweep", "s"), {"show"}),
        (("sweep", "study.toml", "--sch"), {"--scheduler"}),
    ],
)
def test_the_shell_completes(monkeypatch, words, expected):
    monkeypatch.setenv("_HAPTICNET_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", " ".join(["hapticnet", *words]))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    assert set(hapticnet().stdout.split()) == expected
