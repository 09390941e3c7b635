"""Compile the core ahead of time with mypyc: the same source, several times as fast.

A wheel that is built with ``HATCH_BUILD_HOOKS_ENABLE=1`` (``make wheel``) has the compiled core; any other is plain
Python. ``python hatch_build.py`` compiles in place (``make fast``), and ``python hatch_build.py --clean`` removes that
again (``make plain``).
"""

import os
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent

COMPILED: Final = (
    "hapticnet/samples.py",
    "hapticnet/perception.py",
    "hapticnet/vectors.py",
    "hapticnet/outlook.py",
    "hapticnet/scene/*.py",
    "hapticnet/codec/**/*.py",
    "hapticnet/protocol/*.py",
    "hapticnet/channel/*.py",
    "hapticnet/operator/*.py",
    "hapticnet/control/*.py",
    "hapticnet/device/*.py",
    "hapticnet/node/*.py",
)
"""What is compiled: the way of a force sample."""

PLAIN: Final = {
    "base.py": "protocols of user objects, which mypyc cannot check at run time",
    "user.py": "wraps objects of users",
    "settings.py": "frozen settings that are pickled and replaced",
    "__init__.py": "nothing to gain",
}
"""Names of modules that stay plain Python wherever they stand, and why."""

PLAIN_FILES: Final = {
    "hapticnet/codec/plugins.py": "reads classes of users",
    "hapticnet/device/profile.py": "models of pydantic",
    "hapticnet/node/offline.py": "derives from a plain class with slots",
    "hapticnet/protocol/key_files.py": "models of pydantic",
    "hapticnet/scene/config.py": "models of pydantic",
    "hapticnet/scene/presets.py": "models of pydantic",
    "hapticnet/codec/recording.py": "numba compiles what it calls",
    "hapticnet/codec/threshold_sweep.py": "numba compiles it",
}
OPTIMISATION: Final = os.environ.get("HAPTICNET_OPTIMISATION", "3")


def modules() -> list[str]:
    """Return the files to compile, relative to the root."""
    found = {file.relative_to(ROOT).as_posix() for pattern in COMPILED for file in ROOT.glob(pattern)}
    return sorted(
        file
        for file in found
        if Path(file).name not in PLAIN and not file.endswith("_settings.py") and file not in PLAIN_FILES
    )


def compile_in_place() -> list[Path]:
    """Compile, put each extension beside its source, and return the extensions."""
    from mypyc.build import mypycify
    from setuptools import Distribution
    from setuptools.command.build_ext import build_ext

    os.chdir(ROOT)
    arguments = ["--config-file", "pyproject.toml", *modules()]
    extensions = mypycify(arguments, opt_level=OPTIMISATION, target_dir="build/mypyc", multi_file=True)
    command = build_ext(Distribution({"name": "hapticnet", "ext_modules": extensions}))
    command.inplace = True
    command.build_temp = "build/mypyc"
    command.ensure_finalized()
    command.run()
    return [Path(each) for each in command.get_outputs()]


def clean() -> None:
    """Remove what `compile_in_place` has made."""
    for pattern in ("*__mypyc*.so", "hapticnet/**/*.so"):
        for file in ROOT.glob(pattern):
            file.unlink()


if __name__ == "__main__":
    clean()
    if "--clean" not in sys.argv:
        print(*compile_in_place(), sep="\n")
