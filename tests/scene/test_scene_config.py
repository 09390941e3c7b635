import dataclasses
from pathlib import Path

import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.scene.settings import BodySceneSettings, Plane, SceneSettings, Sphere, Tissue
from hapticnet.scene.sources import find_scene, parse_scene

SCENE = """\
name = "two"

[[tissue]]
name = "back"
rest_position_m = 0.04
stiffness_n_per_m = 350
breach_force_n = 3.5
viscosity_n_s_per_m = 1.0
shaft_friction_n = 0.2
shaft_presliding_m = 0.001
stiffening_per_m = 50.0
recovery_time_s = 0.5

[[tissue]]
name = "front"
rest_position_m = 0.02
stiffness_n_per_m = 200.0
breach_force_n = 2.0
"""


def test_a_file_describes_tissues_by_their_attributes() -> None:
    front = Tissue(name="front", rest_position_m=0.02, stiffness_n_per_m=200.0, breach_force_n=2.0)
    back = Tissue(
        name="back",
        rest_position_m=0.04,
        stiffness_n_per_m=350.0,
        breach_force_n=3.5,
        viscosity_n_s_per_m=1.0,
        shaft_friction_n=0.2,
        shaft_presliding_m=0.001,
        stiffening_per_m=50.0,
        recovery_time_s=0.5,
    )
    assert parse_scene(SCENE, "two.toml") == SceneSettings(name="two", tissues=(front, back))


def test_every_attribute_of_a_tissue_is_a_key() -> None:
    assert all(f"\n{field.name} = " in SCENE for field in dataclasses.fields(Tissue))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'name = "two"\n',
            'name = "two"\nspeed = 1\n',
            r"unknown key 'speed' .*the keys are name, tissue, plane, sphere",
        ),
        ("shaft_friction_n", "friction_n", r"tissue 1: unknown key 'friction_n' .*; the keys are .*shaft_friction_n"),
        ("breach_force_n = 2.0\n", "", r"tissue 2: breach_force_n is missing"),
        ('name = "two"\n', "", r"name is missing"),
        ("= 350", '= "350"', r"tissue 1: stiffness_n_per_m is '350'"),
        ("= 350", "= true", r"tissue 1: stiffness_n_per_m is True"),
        ("= 350", "= nan", r"tissue 'back': stiffness_n_per_m is nan"),
        ("= 350", "= -inf", r"tissue 'back': stiffness_n_per_m is -inf"),
        ("= 350", "= 1e300", r"tissue 'back': stiffness_n_per_m is 1e\+300"),
        ("= 350", "= 1" + "0" * 400, r"tissue 1: stiffness_n_per_m is 10+\.\.\.0+; "),
        ("= 0.04", "= 0.02", r"tissues 'back' and 'front' both rest at 0.02 m"),
        (SCENE, 'name = "none"\ntissue = []', r"the scene has no tissue"),
        (SCENE, 'name = "odd"\ntissue = [3]', r"tissue 1: the table is 3"),
        (SCENE, 'name = "odd"\ntissue = 3', r"tissue is 3"),
    ],
)
def test_a_mistake_is_reported_in_one_line_with_file_and_key(old: str, new: str, message: str) -> None:
    assert old in SCENE
    with pytest.raises(SettingsError, match=r"^two\.toml: " + message) as caught:
        parse_scene(SCENE.replace(old, new, 1), "two.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "a"\n[[tissue]\n', r"line 2, column \d+"),
        ('name = "a"\nother =', r"line 2, column 8"),
        ('name = "a"\nname = "b"\n', r"line 2, column"),
        ("a = " + "1" * 5000, r"digits"),
        ("a = " + "[" * 5000, r"recursion"),
    ],
)
def test_malformed_toml_is_refused_with_line_and_column(text: str, message: str) -> None:
    with pytest.raises(FileError, match=r"^bad\.toml: not a TOML file: .*" + message):
        parse_scene(text, "bad.toml")


BODIES = """
name = "hill"
[[plane]]
name = "ground"
point_m = [0, 0.01]
inward = [3.0, 4.0]
stiffness_n_per_m = 200
friction = 0.2
[[sphere]]
name = "ball"
centre_m = [0.01, 0.0]
radius_m = 0.005
stiffness_n_per_m = 300
"""


def test_planes_and_spheres_are_read_with_their_vectors() -> None:
    hill = parse_scene(BODIES, "hill.toml")
    assert isinstance(hill, BodySceneSettings)
    ground, ball = hill.bodies
    assert isinstance(ground, Plane)
    assert (ground.point_m, ground.inward, ground.friction) == ((0.0, 0.01), (0.6, 0.8), 0.2)
    assert isinstance(ball, Sphere)
    assert (ball.centre_m, ball.radius_m, hill.axes) == ((0.01, 0.0), 0.005, 2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("friction = 0.2", "friktion = 0.2", r"plane 1: unknown key 'friktion' \(did you mean 'friction'"),
        ("[0, 0.01]", "[0.01]", r"body 'ground': point_m is \[0.01\]; it must be 2 or 3 numbers"),
        ("[0, 0.01]", "0.01", r"plane 1: point_m is 0.01; it must be a list"),
        ("[0.01, 0.0]", "[0.01, 0.0, 0.0]", r"body 'ground' has 2 axes and body 'ball' 3"),
        ("radius_m = 0.005", "radius_m = -1", r"body 'ball': radius_m is -1"),
        ("[[sphere]]", "[[tissue]]", r"tissue 1: unknown key"),
    ],
)
def test_a_mistake_in_a_body_is_reported_in_one_line(old: str, new: str, message: str) -> None:
    assert old in BODIES
    with pytest.raises(SettingsError, match=r"^hill\.toml: " + message):
        parse_scene(BODIES.replace(old, new, 1), "hill.toml")


def test_tissues_and_bodies_in_one_scene_are_refused() -> None:
    with pytest.raises(SettingsError, match="2 tissues and 1 bodies"):
        parse_scene(SCENE + BODIES[BODIES.index("[[sphere]]") :], "both.toml")


@pytest.mark.parametrize("content", [None, b'name = "\xff"'])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "odd.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=r"odd\.toml: "):
        find_scene(str(path))


def test_a_directory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(FileError, match="directory"):
        find_scene(f"{tmp_path}/folder.toml")
