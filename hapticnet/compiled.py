"""Plain functions compiled by numba (the ``fast`` extra), without changes to their modules.

A function is compiled together with every plain function of hapticnet, and of its own package, that it calls by name.
The subset is numba's nopython mode; tuples of 1 to 3 floats stand for vectors, and ``if len(x) == 1`` is
decided when it is compiled.

Machine code is kept in ``$XDG_CACHE_HOME/hapticnet`` (or ``$NUMBA_CACHE_DIR``), in a folder named after the content of
the sources (hapticnet's, and the folder of a user's function), so that an edited constant or function is
never run from old machine code. Where that folder cannot be written, or another account can write it, each process
compiles what it uses.
"""

import hashlib
import importlib.util
import math
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from itertools import chain
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, Final

from hapticnet import rounding

SOURCES: Final = ("*.py", "codec/**/*.py", "measure/*.py")  # sources whose content names the folder of machine code

LARGEST_INLINED: Final = 900
"""Size of the bytecode [B] up to which a function is compiled into its callers. Larger ones are called: they run only
at updates. The cost of a call grows with the numbers in its arguments, so functions of a codec's state are inlined."""


def describe_core() -> str:
    """Return how the core of this installation was built: as plain Python or compiled ahead of time (mypyc)."""
    spec = importlib.util.find_spec("hapticnet.vectors")
    return "plain Python" if spec is None or str(spec.origin).endswith(".py") else "compiled core"


@cache
def fast_extra_installed() -> bool:
    """Return whether the ``fast`` extra (numba) can be imported, without importing it."""
    return importlib.util.find_spec("numba") is not None


_compiled: dict[tuple[Any, ...], Callable[..., Any]] = {}


def compiled(
    function: Callable[..., Any], *, name: str = "", using: Mapping[str, Any] | None = None, makes_arrays: bool = False
) -> Callable[..., Any]:
    """Return a function of module level, without closures, compiled: the same object every time.

    Constants and named tuples of functions in `using` replace its globals; `name` distinguishes versions with other
    ones. With `makes_arrays`, references to arrays are counted, which can take most of the time of a loop.
    """
    function = _from_source(function)
    key = function, name, tuple((using or {}).values())
    if key not in _compiled:
        _compiled[key] = _bodies().get(function) or _jit(
            _linked(function, name, using or {}),
            inline=not using and len(function.__code__.co_code) <= LARGEST_INLINED,
            counts=makes_arrays,
            folders=_folders_of_users(function, using or {}),
        )
    return _compiled[key]


def _folders_of_users(function: FunctionType, using: Mapping[str, Any]) -> frozenset[Path]:
    """Return the folders of functions from outside hapticnet."""
    tuples = [value for value in using.values() if isinstance(value, tuple)]
    functions = [each for each in (function, *chain(*tuples)) if not _is_ours(each)]
    return frozenset(Path(each.__code__.co_filename).parent for each in functions)


def _is_ours(function: Callable[..., Any]) -> bool:
    return str(function.__module__).startswith("hapticnet.")


def _from_source(function: Callable[..., Any]) -> FunctionType:
    """Return a function with its bytecode, which numba reads; functions compiled by mypyc have none."""
    if isinstance(function, BuiltinFunctionType) and _is_ours(function):
        function = getattr(_from_its_source(function.__module__), function.__name__)
    if not isinstance(function, FunctionType):
        raise TypeError(f"{function!r} is not a plain function")
    return function


@cache
def _from_its_source(name: str) -> ModuleType:
    """Return a compiled module as plain Python, with the classes and constants of the compiled one."""
    made = sys.modules[name]
    file = Path(str(made.__file__)).with_name(f"{name.rpartition('.')[2]}.py")
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None  # noqa: S101 - for the type checker
    assert spec.loader is not None  # noqa: S101 - for the type checker
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for each, value in vars(made).items():
        if each in vars(module) and not isinstance(vars(module)[each], FunctionType):
            setattr(module, each, value)
    return module


def _linked(function: FunctionType, name: str, using: Mapping[str, Any]) -> FunctionType:
    """Return a function whose globals are compiled where they are functions of hapticnet or of its own package."""
    scope = dict(function.__globals__)
    for replaced, value in using.items():
        if isinstance(value, tuple):
            made: Callable[..., Any] = type(value)
            value = made(*[compiled(each) for each in value])
        scope[replaced] = value
    for called in function.__code__.co_names:
        other = scope.get(called)
        if not isinstance(other, FunctionType | BuiltinFunctionType):
            continue
        if _is_ours(other) or _are_together(other, function):
            scope[called] = compiled(other)
    linked = FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
    linked.__qualname__ = f"{name}.{function.__qualname__}" if name else function.__qualname__
    linked.__module__ = function.__module__
    return linked


def _are_together(one: Callable[..., Any], other: Callable[..., Any]) -> bool:
    """Return whether two functions belong to the same top-level package."""
    return str(one.__module__).partition(".")[0] == str(other.__module__).partition(".")[0]


def _jit(
    function: Callable[..., Any], *, inline: bool, counts: bool = False, folders: frozenset[Path] = frozenset()
) -> Callable[..., Any]:
    from numba import config as numba_config
    from numba import njit

    references: Any = {"_nrt": counts}  # an option of numba that its stubs lack
    config: Any = numba_config  # numba sets its settings by name on import
    given = config.CACHE_DIR
    folder = _folder(given, folders)
    config.CACHE_DIR = str(folder)
    try:
        jitted: Callable[..., Any] = njit(
            cache=folder is not None, nogil=True, error_model="numpy", forceinline=inline, **references
        )(function)
    finally:
        config.CACHE_DIR = given
    return jitted


@cache
def _folder(base: str, folders: frozenset[Path] = frozenset()) -> Path | None:
    """Return the folder for present machine code; None if others can write it, or we cannot."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    files = {file for pattern in SOURCES for file in package.glob(pattern)}
    for file in sorted(files.union(*[folder.glob("*.py") for folder in folders])):
        digest.update(file.read_bytes())
    try:
        caches = Path(base or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hapticnet"
        folder = caches / digest.hexdigest()[:16]
        caches.parent.mkdir(parents=True, exist_ok=True)
        for each in (caches, folder):
            each.mkdir(mode=0o700, exist_ok=True)
            if each.lstat().st_uid not in (0, os.geteuid()) or each.stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                return None
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError):  # RuntimeError: there is no home directory
        return None  # numba would keep it beside the sources, and use it even after a called function was edited
    return folder


@cache
def _bodies() -> dict[Callable[..., Any], Callable[..., Any]]:
    """Return the compiled bodies of `rounding`."""
    import numpy as np

    def as_single(x: float) -> float:
        return np.float64(np.float32(x))

    def as_half(x: float) -> float:
        # Eleven bits, of which the last is worth no less than 2 ** -24.
        _, exponent = math.frexp(x)
        unit = math.ldexp(1.0, max(exponent, -13) - 11)
        units: float = np.rint(x / unit)
        return units * unit

    def nearest(x: float) -> float:
        whole: float = np.rint(x)
        return whole

    from numba import njit

    inline = njit(nogil=True, error_model="numpy", forceinline=True)
    return {
        _from_source(rounding.as_single): inline(as_single),
        _from_source(rounding.as_half): inline(as_half),
        _from_source(rounding.nearest): inline(nearest),
    }
