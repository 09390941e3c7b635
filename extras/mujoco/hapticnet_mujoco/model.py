"""Prepare a user's MJCF model to be touched: joints for its tool, a frame for the hand, a coupling, and a force sensor.

The coupling is one actuator along each axis of the frame, from a site in the world to the tool's centre of mass:

    F = K (x_d − x) + B (v_d − v)

with the wanted position x_d. It acts on arms through all their joints, and MuJoCo integrates it with the rest.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import SettingsError

MODELS: Final = Path(__file__).parent / "models"  # where a name without suffix is looked up
STIFFEST: Final = 0.5
"""Largest K h² / m of a coupling with steps h. Above it, the steps are too long for the damping."""

PREFIX: Final = "hapticnet"  # of the names of all that this package adds to a model
NET_FORCE: Final = 3  # a contact sensor then gives the sum of all contacts, in the axes of the world
_AXES: Final = re.compile("(-?[xyz]){1,3}")


def axes_from(text: str) -> list[tuple[int, int]]:
    """Return coordinate and sign of each axis written as ``-z`` or ``x-zy``; SettingsError if invalid."""
    parts = re.findall("-?[xyz]", text)
    axes = [("xyz".index(part[-1]), -1 if part[0] == "-" else 1) for part in parts]
    if not _AXES.fullmatch(text) or len({coordinate for coordinate, _ in axes}) != len(axes):
        raise SettingsError(f"axes is {text!r}; it must be one to three of x, y, z or -x, -y, -z, as in -z or -zxy")
    return axes


def load(path: str) -> Any:
    """Return the specification of a model; SettingsError if there is none, or MuJoCo cannot read it."""
    file = Path(path).expanduser()
    if not file.suffix and (MODELS / f"{path}.xml").exists():
        file = MODELS / f"{path}.xml"
    if not file.is_file():
        own = ", ".join(sorted(each.stem for each in MODELS.glob("*.xml")))
        raise SettingsError(f"model {path!r}: no such file; give the path of an MJCF file, or one of: {own}")
    try:
        return mujoco.MjSpec.from_file(str(file))
    except (ValueError, mujoco.FatalError) as error:
        raise SettingsError(f"model {path}: {one_line(error)}") from None


def compiled(spec: Any, what: str) -> Any:
    """Return the model of a specification; SettingsError if MuJoCo cannot compile it."""
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SettingsError(f"{what}: {one_line(error)}") from None


def one_line(error: BaseException) -> str:
    """Return the message of MuJoCo on one line."""
    return " ".join(str(error).split())


def tool_of(spec: Any, name: str, what: str) -> Any:
    """Return the body of this name; SettingsError if there is none."""
    body = spec.body(name)
    if body is None or name == "world":
        names = [each.name for each in spec.bodies if each.name not in ("", "world")]
        raise SettingsError(f"{what}: has no body {name!r} as tool; it has: {', '.join(names[:20]) or 'no named body'}")
    return body


def _loosen(spec: Any, tool: Any) -> None:
    """Delete the joints of a tool, and what joins it to a mocap body: the coupling takes its place. Take its weight."""
    mocaps = {each.name for each in spec.bodies if each.mocap and each.name != tool.name}
    for equality in list(spec.equalities):
        if tool.name in (equality.name1, equality.name2) and mocaps & {equality.name1, equality.name2}:
            spec.delete(equality)
    for joint in list(tool.joints):
        spec.delete(joint)
    tool.mocap, tool.gravcomp = False, 1.0


def slides(spec: Any, tool: Any, coordinates: Sequence[int], pose: FloatArray, armature_kg: float) -> None:
    """Let a tool move along axes of a frame only, whatever joints it had; `pose` is its rotation to that frame."""
    _loosen(spec, tool)
    for coordinate in coordinates:
        tool.add_joint(
            name=f"{PREFIX} {coordinate}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=pose[coordinate],
            armature=armature_kg,
        )


def couple(spec: Any, tool: Any, centre: FloatArray, frame: str, axes: Sequence[tuple[int, int]]) -> None:
    """Add an actuator along each axis of a frame to the centre of mass of a tool, and a sensor of what touches it."""
    tool.add_site(name=f"{PREFIX} tool", pos=centre)
    for coordinate, sign in axes:
        gear = np.zeros(6)
        gear[coordinate] = sign
        spec.add_actuator(
            name=f"{PREFIX} {coordinate}",
            trntype=mujoco.mjtTrn.mjTRN_SITE,
            target=f"{PREFIX} tool",
            refsite=frame,
            gear=gear,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )
    spec.add_sensor(
        name=f"{PREFIX} contact",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,  # the tool and all that hangs on it
        objname=tool.name,
        intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), NET_FORCE, 1],
    )


def float_freely(spec: Any, tool: Any) -> None:
    """Let a tool move and turn freely, whatever joints it had. It and its child bodies have no weight."""
    _loosen(spec, tool)
    tool.add_freejoint(name=f"{PREFIX} pose")
    for each in tool.find_all("body"):
        each.gravcomp = 1.0


def couple_pose(spec: Any, point: str, position: FloatArray, quat: FloatArray, grip: tuple[Any, str] | None) -> None:
    """Add a mocap body at a pose, and actuators that pull a site of the tool to it along and about its axes.

    `grip` is the kind (of transmission) and the name of what opens the gripper, if there is one.
    """
    hand = spec.worldbody.add_body(name=f"{PREFIX} hand", mocap=True, pos=position, quat=quat)
    hand.add_site(name=f"{PREFIX} hand")
    shared = {"gaintype": mujoco.mjtGain.mjGAIN_FIXED, "biastype": mujoco.mjtBias.mjBIAS_AFFINE}
    for index in range(6):
        spec.add_actuator(
            name=f"{PREFIX} {index}", trntype=mujoco.mjtTrn.mjTRN_SITE, target=point, refsite=f"{PREFIX} hand",
            gear=np.eye(6)[index], **shared,
        )  # fmt: skip
    if grip is not None:
        kind, target = grip
        spec.add_actuator(name=f"{PREFIX} grip", trntype=kind, target=target, **shared)
    kinds = ("FORCE", "TORQUE", "POS")
    spec.add_sensor(
        name=f"{PREFIX} contact",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=spec.site(point).parent.name,
        intprm=[sum(1 << int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{each}")) for each in kinds), NET_FORCE, 1],
    )
