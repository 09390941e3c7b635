"""Built-in scenes."""

import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from hapticnet.checks import meant
from hapticnet.errors import SettingsError
from hapticnet.files import user_path
from hapticnet.scene.tissue import SceneSettings, Tissue

if TYPE_CHECKING:
    from hapticnet.scene.config import AnySceneSettings

PAPER_BREACH_FORCES_N: Final = (2.0, 3.5, 5.0)
"""Breach forces [N] of the three tissues of "Cutaneous haptic deadband compression"."""

PAPER_GAP_M: Final = 20e-3
"""Distance [m] between surfaces, and in front of the first. The paper states none: an assumption."""

_PRESETS: Final = files("hapticnet.scene") / "presets"


def paper_scene(seed: int) -> SceneSettings:
    """Return the paper's three tissues, with their breach forces in an order drawn from `seed`.

    Each is breached at half the distance to the next surface (the last at the same depth), which gives stiffnesses of
    200, 350 and 500 N/m.

    Raises
    ------
    SettingsError
        If the seed is negative.
    """
    if seed < 0:
        raise SettingsError(f"the seed of the paper's scene is {seed}; it must be a whole number, 0 or greater")
    breach_forces_n = np.random.default_rng(seed).permutation(PAPER_BREACH_FORCES_N).tolist()
    return SceneSettings(
        name=f"paper:{seed}",
        tissues=tuple(
            Tissue(
                name=f"tissue {number}",
                rest_position_m=number * PAPER_GAP_M,
                stiffness_n_per_m=breach_force_n / (PAPER_GAP_M / 2.0),
                breach_force_n=breach_force_n,
            )
            for number, breach_force_n in enumerate(breach_forces_n, start=1)
        ),
    )


def scene_file(spec: str) -> Path | None:
    """Return the path of the file that `spec` names; None for a built-in scene."""
    path = user_path(spec)
    return path if path.suffix == ".toml" and spec not in scene_names() else None


def find_scene(spec: str, folder: Path = Path()) -> "AnySceneSettings":
    """Return the scene named by ``paper``, ``paper:SEED``, a preset's name or the path of a TOML file.

    ``paper`` alone is ``paper:0``. A path is relative to `folder`.

    Raises
    ------
    SettingsError
        If there is no such scene, or a value is invalid.
    FileError
        If the file is missing, unreadable or malformed.
    """
    if spec == "paper" or spec.startswith("paper:"):
        return paper_scene(_paper_seed(spec))
        # Imported here: pydantic is slow to import, and the paper's scene does not need it.
    from hapticnet.scene.config import load_scene, parse_scene

    if spec in scene_names():
        return parse_scene((_PRESETS / f"{spec}.toml").read_text(encoding="utf-8"), spec)
    path = scene_file(spec)
    if path is None:
        raise SettingsError(
            f"unknown scene {spec!r}{meant(spec, ['paper', *scene_names()])}; choose from paper, paper:SEED,"
            f" {', '.join(scene_names())}, the path of a .toml file, recording:FILE, FILE.py:CLASS or"
            " package.module:CLASS"
        )
    return load_scene(folder / path)


def scene_names() -> list[str]:
    """Return the names of the scenes stored as TOML files."""
    return sorted(entry.name.removesuffix(".toml") for entry in _PRESETS.iterdir() if entry.name.endswith(".toml"))


def _paper_seed(spec: str) -> int:
    seed = spec.removeprefix("paper").removeprefix(":") if spec != "paper" else "0"
    if not re.fullmatch("[0-9]{1,18}", seed):
        raise SettingsError(f"scene {spec!r}: expected a whole number (0 or greater) as the seed after 'paper:'")
    return int(seed)
