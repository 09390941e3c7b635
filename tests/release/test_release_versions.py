"""One version for all that is published, and what is checked before it is."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

import hapticnet
from release.build import PACKAGES, write_digests
from release.publish import commands, expected, problems
from release.sbom import UnknownLicenceError, audit

ROOT = Path(__file__).parents[2]
VERSION = hapticnet.__version__


def test_every_package_has_the_version_of_hapticnet_and_needs_that_series_of_it():
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dynamic"] == ["version"]
    for package in PACKAGES:
        project = tomllib.loads((ROOT / package / "pyproject.toml").read_text())["project"]
        assert project["version"] == VERSION
        assert f"hapticnet~={VERSION}" in project["dependencies"]
    assert {f"extras/{path.name}" for path in (ROOT / "extras").iterdir() if path.is_dir()} < {*PACKAGES}


def test_the_other_files_that_state_a_version_state_this_one():
    cmake = (ROOT / "peers" / "c" / "CMakeLists.txt").read_text()
    assert re.search(r"^project\(hapticnet VERSION (\S+)", cmake, re.MULTILINE)[1] == VERSION
    for package in ("js", "csharp/Hapticnet"):
        assert json.loads((ROOT / "peers" / package / "package.json").read_text())["version"] == VERSION
    crate = tomllib.loads((ROOT / "peers" / "rust" / "Cargo.toml").read_text())["package"]
    assert crate["version"] == VERSION
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == VERSION
    assert re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1] == VERSION


@pytest.fixture
def release(tmp_path):
    """Return a checkout with a tagged commit, and a whole release that was built from it."""
    root, out = tmp_path / "checkout", tmp_path / "dist"
    (root / "hapticnet").mkdir(parents=True)
    (root / "hapticnet" / "__init__.py").write_text('__version__ = "1.2.3"\n')
    (root / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3 (2030-01-31)\n")
    identity = ["-c", "user.name=owner", "-c", "user.email=owner@localhost", "-c", "commit.gpgsign=false"]
    for command in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "Release"], ["tag", "v1.2.3"]):
        subprocess.run(["git", "-C", root, *command], check=True)
    commit = subprocess.check_output(["git", "-C", root, "rev-parse", "HEAD"], text=True).strip()
    out.mkdir()
    for pattern in expected("1.2.3"):
        (out / pattern.replace("*", "x")).write_text(pattern)
    (out / "origin.json").write_text(json.dumps({"commit": commit}))
    write_digests(out)
    return root, out


def test_a_whole_release_of_a_tagged_commit_can_be_published(release):
    root, out = release
    assert problems(root, out) == []
    upload = next(command for command in commands("1.2.3", out, "REGISTRY/NAME") if "upload" in command)
    packages = {"hapticnet-1.2.3-py3-none-any.whl", "hapticnet-1.2.3-xmanylinuxx.whl", "hapticnet-1.2.3.tar.gz"}
    assert {Path(each).name for each in upload if each.startswith(str(out))} == packages


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda root, _: (root / "new.py").write_text(""), "files here differ"),
        (lambda root, _: subprocess.run(["git", "-C", root, "tag", "-d", "v1.2.3"], check=True), "no tag v1.2.3"),
        (lambda root, _: (root / "CHANGELOG.md").write_text("## 1.2.3 (unreleased)\n"), "no date for 1.2.3"),
        (lambda _, out: (out / "hapticnet-1.2.3.tgz").write_text("altered"), "hapticnet-1.2.3.tgz differs"),
        (lambda _, out: (out / "added.whl").write_text(""), "added.whl differs"),
        (lambda _, out: (out / "SHA256SUMS").unlink(), "has no SHA256SUMS"),
        (lambda _, out: (out / "origin.json").write_text('{"commit": "0123456789"}'), "was built from 01234567"),
        (lambda _, out: (out / "hapticnet-1.2.3.cdx.json").unlink(), "has no hapticnet-1.2.3.cdx.json"),
        (lambda _, out: (out / "SHA256SUMS").write_bytes(b"\xff"), "SHA256SUMS is damaged; make release"),
        (lambda _, out: (out / "SHA256SUMS").write_text("no digest\n"), "SHA256SUMS is damaged"),
        (lambda _, out: (out / "origin.json").write_text("[]"), "origin.json is damaged"),
        (lambda _, out: (out / "origin.json").unlink(), "has no origin.json"),
        (lambda _, out: (out / "folder").mkdir(), "folder differs"),
    ],
)
def test_what_is_wrong_with_a_release_is_said(release, spoil, said):
    root, out = release
    spoil(root, out)
    assert any(said in each for each in problems(root, out))


def test_a_component_without_a_permitted_licence_is_named(capsys):
    permitted = {"name": "numpy", "licenses": [{"expression": "BSD-3-Clause AND MIT"}]}
    audit([permitted])
    assert "BSD-3-Clause AND MIT: numpy" in capsys.readouterr().out
    copyleft = {"name": "copyleft", "licenses": [{"license": {"id": "AGPL-3.0-only"}}]}
    with pytest.raises(UnknownLicenceError, match="bare, copyleft;"):
        audit([permitted, copyleft, {"name": "bare"}])
