"""Verbs of installed packages: entry points of the group ``hapticnet.verbs``."""

import re
import sys
from importlib.metadata import Distribution, EntryPoint

import pytest

from hapticnet.cli import plugins
from tests.cli.test_cli_errors import assert_only_line

WELL = """
import typer

app = typer.Typer()


@app.command()
def well(depth: float = 1.0) -> None:
    print(f"dug to {depth:g} m")


@app.command()
def dry() -> None: ...
"""


class Package(Distribution):
    def read_text(self, filename):
        return "Name: hapticnet-dig\nVersion: 1\nSummary: Dig for things\n" if filename == "METADATA" else None

    def locate_file(self, path):
        raise NotImplementedError


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return what installs a package with one module that offers verbs."""
    monkeypatch.syspath_prepend(tmp_path)

    def make(code, *names):
        (tmp_path / "dig.py").write_text(code)
        monkeypatch.delitem(sys.modules, "dig", raising=False)
        points = [EntryPoint(name, "dig:app", plugins.ENTRY_POINT_GROUP)._for(Package()) for name in names]
        monkeypatch.setattr(plugins, "entry_points", lambda group: points if group == "hapticnet.verbs" else [])

    return make


def test_an_application_of_one_command_is_the_verb(run, install):
    install(WELL.partition("@app.command()\ndef dry")[0], "dig")
    assert run("dig", "--depth", "2").stdout == "dug to 2 m\n"
    assert "--depth" in run("dig", "--help").stdout


def test_the_help_lists_a_verb_of_a_package_without_importing_it(run, install):
    install("raise SystemExit", "dig")
    listed = run("--help").stdout
    assert re.search(r"^  dig +Dig for things\.$", listed, re.M)
    assert "dig" not in sys.modules


def test_a_verb_of_a_package_runs(run, install):
    install(WELL, "dig")
    assert run("dig", "well", "--depth", "2").stdout == "dug to 2 m\n"
    assert "--depth" in run("dig", "well", "--help").stdout
    assert_only_line(run("dig", "well", "--depth", "deep"), "(see hapticnet dig well --help)", code=2)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import no_such_module", "raised ModuleNotFoundError: No module named 'no_such_module'"),
        ("1 / 0", "raised ZeroDivisionError"),
        ("import sys\nsys.exit(3)", "raised SystemExit"),
        ("", "has no attribute 'app'"),
        ("app = 3", "raised AttributeError"),
    ],
)
def test_a_package_that_cannot_be_imported_is_told_in_one_line(run, install, code, words):
    install(code, "dig")
    done = run("dig", "well")
    assert_only_line(done, words, code=4)
    assert "'hapticnet dig', of the package hapticnet-dig," in done.stderr
    assert run("codecs").returncode == 0


def test_a_verb_of_hapticnet_has_precedence(run, install):
    install("raise SystemExit", "codecs", "dig")
    assert run("codecs").returncode == 0
    assert run("--help").stdout.count("\n  codecs ") == 1


def test_without_its_package_a_verb_of_ours_says_how_to_install_it(run, install):
    install("")
    assert not {"experiment", "gateway"} & {*re.findall(r"^  (\w+)", run("--help").stdout, re.M)}
    for words in (("experiment",), ("experiment", "order", "--participant", "03"), ("experiment", "--help")):
        assert_only_line(run(*words), "pip install ./extras/experiment", code=4)
    assert_only_line(run("gateway"), "pip install ./extras/gateway", code=4)
    assert_only_line(run("dig"), "No such command 'dig'", code=2)
