"""Machine code is made from the functions as they are, and kept for exactly those sources."""

import numpy as np
import pytest

from hapticnet import compiled as compiled_module
from hapticnet.compiled import compiled
from hapticnet.rounding import as_half, as_single, nearest


@pytest.fixture(autouse=True)
def numba(tool_is_missing):
    if not compiled_module.fast_extra_installed():
        tool_is_missing("numba")


@pytest.mark.parametrize("function", [as_single, as_half, nearest])
def test_both_bodies_of_a_rounding_agree(function):
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.normal(size=300) * 10.0 ** rng.uniform(-12, 4, 300), [0.0, -0.0, 0.5, 1.5, 2.5, -0.5]])
    for value in values.tolist():
        plain, fast = function(value), compiled(function)(value)
        assert (plain, np.signbit(plain + 0.0)) == (fast, np.signbit(fast + 0.0))


def test_only_plain_functions_are_compiled_and_each_once():
    assert compiled(nearest) is compiled(nearest)
    with pytest.raises(TypeError, match="not a plain function"):
        compiled(len)


def test_an_edited_source_of_a_user_has_a_folder_of_its_own(tmp_path):
    folder, users = compiled_module._folder.__wrapped__, frozenset({tmp_path / "plug-in"})
    (tmp_path / "plug-in").mkdir()
    made = set()
    for text in ("STEP = 1\n", "STEP = 2\n"):
        (tmp_path / "plug-in" / "codec.py").write_text(text)
        made.add(folder(str(tmp_path), users))
    assert len(made | {folder(str(tmp_path))}) == 3


def test_an_edited_source_has_a_folder_of_its_own(tmp_path, monkeypatch):
    package = tmp_path / "package"
    package.mkdir()
    monkeypatch.setattr(compiled_module, "__file__", str(package / "compiled.py"))
    made = []
    for edit in (0, 1, 0):
        (package / "scheme.py").write_text(f"STEP = {edit}\n")
        made.append(compiled_module._folder.__wrapped__(str(tmp_path / "caches")))
    assert made[0] == made[2] != made[1], "the same source again"


def test_machine_code_that_another_account_could_have_written_is_not_used(tmp_path, monkeypatch):
    """As in /tmp, where anybody can make the folder first."""
    folder = compiled_module._folder.__wrapped__
    inner = folder(str(tmp_path))
    assert inner.stat().st_mode & 0o077 == 0
    for each in (inner, inner.parent):
        for mode in (0o770, 0o777):
            each.chmod(mode)
            assert folder(str(tmp_path)) is None
        each.chmod(0o755)
        assert folder(str(tmp_path)) == inner
    owner = inner.stat().st_uid
    monkeypatch.setattr(compiled_module.os, "geteuid", lambda: owner + 1)
    assert folder(str(tmp_path)) == (inner if owner == 0 else None)


@pytest.mark.parametrize("cache_home", ["a file", ""])
def test_without_a_writable_folder_functions_are_compiled_but_not_kept(cache_home, tmp_path, monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    (tmp_path / "a file").touch()
    monkeypatch.setattr(compiled_module.Path, "home", no_home)
    monkeypatch.setenv("XDG_CACHE_HOME", cache_home and str(tmp_path / cache_home))
    assert compiled_module._folder.__wrapped__("") is None
    monkeypatch.setattr(compiled_module, "_folder", lambda *_: None)
    halved = compiled_module._jit(lambda x: 0.5 * x, inline=False)
    assert halved(3.0) == 1.5
    assert not list(tmp_path.glob("**/*.nb?"))
