"""The code of docs/index.md, api.md, embedding.md and sweep.md runs in order and prints what the pages show."""

import ast
import contextlib
import inspect
import io
import re
import subprocess
import sys
import textwrap
from dataclasses import fields
from pathlib import Path

import pytest

import hapticnet as hn
from hapticnet.codec import registry

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"(?P<before>[^\n]*)\n+```(?P<language>\w+)\n(?P<code>.*?)```", re.DOTALL)
FILE = re.compile(r"Save this as `([\w.]+)`")
API = (DOCS / "refer" / "api.md").read_text()


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    import matplotlib as mpl

    mpl.use("agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_user_codecs", {})
    monkeypatch.setattr(sys, "path", sys.path[:])


@pytest.mark.parametrize("page", ["index.md", "refer/api.md", "use/embedding.md", "use/compare.md"])
def test_the_code_of_a_page_runs_and_prints_what_it_shows(page):
    names = {}
    printed = ""
    ran = 0
    for block in BLOCK.finditer((DOCS / page).read_text()):
        code, file = block["code"], FILE.search(block["before"])
        if file:
            Path(file[1]).write_text(code)
        elif block["language"] == "python":
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(code, page, "exec"), names)  # noqa: S102 - our own pages
            printed = output.getvalue()
            ran += 1
        elif block["language"] == "sh":
            command = code.replace("hapticnet ", f"{sys.executable} -m hapticnet ")
            done = subprocess.run(["bash", "-euc", command], capture_output=True, text=True, timeout=100)
            assert done.returncode == 0, f"{code}{done.stderr}"
            printed = done.stdout
            ran += 1
        elif block["language"] == "text":
            assert printed == code
    assert ran >= 4


def test_every_public_name_has_an_entry_and_a_docstring():
    documented = re.findall(r"^::: hapticnet\.(\w+)$", API, re.MULTILINE)
    assert sorted(documented) == sorted(name for name in hn.__all__ if name != "__version__")
    assert all(inspect.getdoc(getattr(hn, name)) for name in documented)


def fields_with_a_text(kind):
    """Return the fields of a class that a text follows, one or several with the same."""
    described, group = [], []
    for line in ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body[1:]:
        if isinstance(line, ast.AnnAssign):
            group.append(line.target.id)
        else:
            described += group if isinstance(line, ast.Expr) else []
            group = []
    return described


@pytest.mark.parametrize("name", ["Encoded", "Report", "LinkReport", "WeberLaw", "Recording", "Master", "Slave"])
def test_every_field_is_described(name):
    kind = getattr(hn, name)
    described = "".join(f"{each.__doc__} {fields_with_a_text(each)}" for each in kind.__mro__[:-1])
    assert [field.name for field in fields(kind) if not re.search(rf"\b{field.name}\b", described)] == []
