"""Compile the core ahead of time with mypyc: the same source, several times as fast.

A wheel that is built with ``HATCH_BUILD_HOOKS_ENABLE=1`` (``make wheel``) has the compiled core; any other is plain
Python. ``python hatch_build.py`` compiles in place (``make fast``), and ``python hatch_build.py --clean`` removes that
again (``make plain``).
"""

import os
import sys
from pathlib import Path
from typing import Any, Final

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT: Final = Path(__file__).parent

COMPILED: Final = (
    "hapticnet/samples.py",
    "hapticnet/vectors.py",
    "hapticnet/oscillator.py",
    "hapticnet/rounding.py",
    "hapticnet/stiffness_bound.py",
    "hapticnet/measure/running_error.py",
    "hapticnet/scene/*.py",
    "hapticnet/codec/**/*.py",
    "hapticnet/protocol/*.py",
    "hapticnet/channel/*.py",
    "hapticnet/operator/*.py",
    "hapticnet/control/*.py",
    "hapticnet/device/*.py",
    "hapticnet/node/*.py",
)
"""What is compiled: the way of a force sample. What is pickled for other processes, such as laws, is not."""

PLAIN: Final = {
    "base.py": "protocols of user objects, which mypyc cannot check at run time, and what wraps such objects",
    "user.py": "wraps objects of users",
    "settings.py": "frozen settings that are pickled and replaced",
    "__init__.py": "nothing to gain",
}
"""Names of modules that stay plain Python wherever they stand, and why."""

PLAIN_FILES: Final = {
    "hapticnet/codec/parts.py": "stands for codecs of any class",
    "hapticnet/codec/plugins.py": "reads classes of users",
    "hapticnet/control/couplings.py": "dataclasses with class variables",
    "hapticnet/control/ports.py": "protocols of user objects",
    "hapticnet/device/profile.py": "models of pydantic",
    "hapticnet/device/simulated.py": "settings that users make, and others derive from it",
    "hapticnet/node/offline.py": "derives from a plain class with slots",
    "hapticnet/protocol/key_files.py": "models of pydantic",
    "hapticnet/scene/sources.py": "models of pydantic",
    "hapticnet/codec/recording.py": "numba compiles what it calls",
}
EXTENSIONS: Final = ("*__mypyc*.so", "hapticnet/**/*.so")
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
    return [file.relative_to(ROOT) for pattern in EXTENSIONS for file in sorted(ROOT.glob(pattern))]


def clean() -> None:
    """Remove what `compile_in_place` has made."""
    for pattern in EXTENSIONS:
        for file in ROOT.glob(pattern):
            file.unlink()


class CompiledCore(BuildHookInterface[Any]):
    """Compile the core for a wheel."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and name the extensions and the platform to the builder."""
        if self.target_name != "wheel" or version != "standard":
            return
        extensions = compile_in_place()
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["force_include"].update({str(ROOT / each): str(each) for each in extensions})

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002
        """Leave the checkout plain."""
        clean()


if __name__ == "__main__":
    clean()
    if "--clean" not in sys.argv:
        print(*compile_in_place(), sep="\n")
