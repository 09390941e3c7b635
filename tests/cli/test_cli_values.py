"""A value that cannot be meant is refused before a verb does or says anything, in one line that says what is right."""

import pytest

from hapticnet.cli.settings import option_key
from hapticnet.cli.verbs import SERVICES
from tests.cli.test_cli_errors import assert_only_line
from tests.cli.test_cli_options import VERBS, kind
from tests.ready import hapticnet

WRONG = "wrong=§"

ANY_TEXT = {"name", "peer-key"}
"""Options whose values may be any text, or are keys of another host."""

NEEDED = {
    ("slave",): ("--listen", "127.0.0.1:0", "--duration", "0"),
    ("master",): ("--connect", "127.0.0.1:9", "--connect-timeout", "0"),
    ("compare",): ("hand.csv", "--position-column", "x_m", "--scene", "paper:1", "--plot-dir", "plots"),
    ("info",): ("hand.csv",),
    ("replay",): ("hand.csv",),
    ("export",): ("hand.csv",),
    ("sweep", "run"): ("study.toml", "--out-dir", "results"),
    ("sweep", "show"): ("results",),
    ("doctor",): ("--quick", "--hand", "arm", "--delay", "1ms", "--scene", "paper"),
}
"""What else each verb needs, so that only the one value is wrong."""

OPTIONS = [
    (verb, option_key(each))
    for verb, command in VERBS.items()
    for each in command.params
    if each.param_type_name == "option" and kind(each) != "flag" and not option_key(each).endswith("config")
]
GRAMMAR = [
    (verb, name)
    for verb, name in OPTIONS
    if name not in ANY_TEXT
    and not name.endswith("-column")  # the file says which there are
    and kind(next(each for each in VERBS[verb].params if option_key(each) == name)) not in ("FILE", "DIR")
    and verb != ("sweep", "show")  # which reads a finished sweep first: test_cli_sweep.py
]


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.csv").write_text(
        "t_s,f_n,x_m\n" + "".join(f"{n / 1000},{n / 100},{n / 1e5}\n" for n in range(50))
    )
    (tmp_path / "study.toml").write_text('name = "small"\n')


def without(words, name):
    """Return what a verb needs, without an option that is tried."""
    at = words.index(f"--{name}") if f"--{name}" in words else len(words)
    return (*words[:at], *words[at + 2 :])


def refusal(done):
    assert_only_line(done, code=2)
    return done.stderr


@pytest.mark.parametrize(("verb", "name"), OPTIONS, ids=lambda each: each if isinstance(each, str) else " ".join(each))
def test_an_empty_value_is_refused(run, verb, name):
    said = refusal(run(*verb, *without(NEEDED.get(verb, ()), name), f"--{name}="))
    assert f"--{name}" in said
    assert "it is empty; give " in said


@pytest.mark.parametrize(("verb", "name"), GRAMMAR, ids=lambda each: each if isinstance(each, str) else " ".join(each))
def test_a_value_of_the_wrong_form_is_refused(run, verb, name):
    start = hapticnet if verb[0] in SERVICES else run  # what is to run in real time changes its process
    assert WRONG in refusal(start(*verb, *without(NEEDED.get(verb, ()), name), f"--{name}={WRONG}"))


@pytest.mark.parametrize(
    ("words", "right"),
    [
        (("slave", "--add-codec", "deadbnad"), "unknown codec 'deadbnad' (did you mean 'deadband'?); there are: raw,"),
        (("master", "--name", "x" * 65), "it must be 1 to 64 printable bytes"),
        (("master", "--positions", "lines"), "'lines' is not one of 'raw', 'line'"),
        (("demo", "--rate", "3"), "rate is 3.0 Hz; it must be between 20 and 100000 Hz"),
        (("sweep", "show", "results", "--x", "loss"), "--x needs --plot"),
        (("sweep", "run", "study.toml", "--scheduler", "127.0.0.1:8786"), "must be tcp://HOST:PORT or tls://HOST:PORT"),
    ],
)
def test_a_refusal_says_what_would_be_right(words, right):
    assert right in refusal(hapticnet(*words))
