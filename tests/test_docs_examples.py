"""The code of docs/index.md, api.md, embedding.md and sweep.md runs in order and prints what the pages show."""

import contextlib
import inspect
import io
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
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
    assert ran >= 5


def test_every_public_name_has_an_entry_with_its_signature():
    documented = dict(re.findall(r"^### `hn\.(\w+)(.*)`$", API, re.MULTILINE))
    public = [name for name in hn.__all__ if name != "__version__"]
    assert sorted(documented) == sorted(public)
    for name in public:
        thing = getattr(hn, name)
        if inspect.isfunction(thing) or documented[name]:
            parameters = inspect.signature(thing).parameters
            written = re.sub(r"\s", "", documented[name])
            shown = re.findall(r"[(,](?:\*,)?(\*{0,2}\w+)", re.sub(r'"[^"]*"|=\([^)]*\)', "", written))
            expected = [
                f"**{each.name}" if each.kind is each.VAR_KEYWORD else each.name for each in parameters.values()
            ]
            assert shown == expected, name


@pytest.mark.parametrize("name", ["Encoded", "Report", "LinkReport", "WeberLaw"])
def test_every_field_of_a_result_is_described(name):
    kind = getattr(hn, name)
    assert is_dataclass(kind)
    for field in fields(kind):
        assert f"`{field.name}`" in API, field.name
