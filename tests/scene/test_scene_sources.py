"""Where the scenes of a slave come from."""

import dataclasses
import gc
import sys
from pathlib import Path
from subprocess import run

import numpy as np
import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.base import UserScene
from hapticnet.scene.recorded import RecordedScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import BodySceneSettings, Plane, SceneSettings, Sphere, Tissue
from hapticnet.scene.sources import (
    RecordedSource,
    as_touchable,
    find_scene,
    find_source,
    make_scene,
    paper_scene,
    parse_scene,
    scene_names,
)
from tests.recordings.session_cases import write_csv

RIG = """
made = []

class Spring:
    def __init__(self, stiffness=100.0):
        made.append(self)
        self.stiffness, self.closed = stiffness, False

    def step(self, sample):
        return self.stiffness * sample.position_m[0]

class Robot(Spring):
    shared = True
    name = "the robot"
    ends = []

    def close(self):
        self.ends.append(self.stiffness)

class Sensitive(Robot):
    shared = False
    ends = []

    def close(self):
        super().close()
        raise OSError("port gone")

class Closed:
    def __init__(self):
        raise OSError("no such port")
"""

AT = PositionSample(0, (0.02,))


@pytest.fixture(autouse=True)
def rig(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.py").write_text(RIG)


def module_of(source):
    return vars(__import__("sys").modules[type(source.make().touched).__module__])


def test_tissues_are_new_for_each_master():
    source = find_source("paper:1")
    one, other = source.make(), source.make()
    assert isinstance(one, Scene)
    assert one is not other
    assert (source.name, source.file, source.close()) == ("paper:1", None, [])


def test_a_class_of_the_user_makes_an_object_for_each_master_and_the_first_one_early():
    source = find_source("rig.py:Spring:stiffness=50")
    made = module_of(source)["made"]
    made.clear()
    source.prepare()
    source.prepare()
    assert (len(made), source.name, str(source.file)) == (1, "Spring", "rig.py")
    one, other = source.make(), source.make()
    assert len(made) == 2
    assert (one.step(AT).force_n, other.step(AT).force_n) == ((1.0,), (1.0,))


def test_a_shared_object_serves_all_masters_and_is_closed_once():
    source = find_source("rig.py:Robot:stiffness=3")
    source.prepare()
    assert source.name == "the robot"
    assert source.make().touched is source.make().touched
    ends = source.make().touched.ends
    assert (source.close(), source.close(), ends) == ([], [], [3])


def test_an_object_that_nobody_needs_any_more_is_closed_and_what_it_raises_is_told_at_the_end():
    source = find_source("rig.py:Sensitive")
    scene = source.make()
    ends = scene.touched.ends
    ends.clear()
    del scene
    gc.collect()
    assert len(ends) == 1
    (fault,) = source.close()
    assert fault.startswith("scene rig.py:Sensitive: close raised OSError: port gone (rig.py, line ")
    assert source.close() == []


def test_what_cannot_be_made_is_told_before_a_master_comes():
    source = find_source("rig.py:Closed")
    with pytest.raises(
        SettingsError, match=r"scene rig.py:Closed: making it raised OSError: no such port \(rig.py, line"
    ):
        source.prepare()


def test_paths_are_relative_to_the_folder_of_the_list_that_names_them(tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert find_source("rig.py:Spring", tmp_path).make().name == "Spring"
    with pytest.raises(SettingsError, match=r"cannot find rig.py"):
        find_source("rig.py:Spring")


@pytest.mark.parametrize(
    ("spec", "error", "message"),
    [
        ("nowhere", SettingsError, "unknown scene 'nowhere'; choose from paper, .*FILE.py:CLASS or package"),
        ("paper:red", SettingsError, "expected a whole number"),
        ("none.toml", FileError, "none.toml"),
        ("rig.py", SettingsError, r"name the class in the file too, as in rig.py:MyClass"),
        ("rig.py:Nothing", SettingsError, "rig.py defines no class 'Nothing'; it defines Spring, Robot, Sens"),
    ],
)
def test_what_is_not_there_is_named(spec, error, message):
    with pytest.raises(error, match=message):
        find_source(spec)


def test_objects_given_to_the_library():
    scene = Scene(find_scene("paper").tissues)
    assert as_touchable(scene) is scene

    class Wall:
        def step(self, _):
            return 1.0

    wall = as_touchable(Wall())
    assert isinstance(wall, UserScene)
    assert as_touchable(wall) is wall
    with pytest.raises(SettingsError, match=r"scene is the class Wall; pass an object of it, Wall\(\)"):
        as_touchable(Wall)
    with pytest.raises(SettingsError, match=r"scene: has no method step\(sample\)"):
        as_touchable(3)


def test_the_papers_scene_has_its_three_breach_forces_in_the_order_of_the_seed() -> None:
    orders = set()
    for seed in range(60):
        tissues = paper_scene(seed).tissues
        orders.add(tuple(tissue.breach_force_n for tissue in tissues))
        assert [tissue.rest_position_m for tissue in tissues] == pytest.approx([0.02, 0.04, 0.06])
        assert [tissue.breach_depth_m for tissue in tissues] == pytest.approx([0.01, 0.01, 0.01])
        assert not any(tissue.depends_on_time or tissue.shaft_friction_n for tissue in tissues)
    assert len(orders) == 6
    assert {tuple(sorted(order)) for order in orders} == {(2.0, 3.5, 5.0)}
    assert paper_scene(7) == paper_scene(7)


def test_a_scene_is_found_by_name_seed_or_path(tmp_path: Path) -> None:
    assert find_scene("paper") == paper_scene(0)
    assert find_scene("paper:12") == paper_scene(12)
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\n[[tissue]]\nname = "a"\nrest_position_m = 0\nstiffness_n_per_m = 1\nbreach_force_n = 1\n'
    )
    assert find_scene(str(path)).name == "mine"


@pytest.mark.parametrize("name", scene_names())
def test_every_preset_makes_a_scene_of_its_name(name: str) -> None:
    settings = find_scene(name)
    assert settings.name == name
    made = make_scene(settings)
    assert made.name == name
    assert made.step(PositionSample(0, (-1.0,) * made.axes)).force_n == (0.0,) * made.axes


def test_the_scenes_of_the_documentation_can_be_read() -> None:
    page = Path(__file__).parents[2] / "docs" / "use" / "scenes.md"
    examples = [block.split("```")[0] for block in page.read_text(encoding="utf-8").split("```toml\n")[1:]]
    assert [make_scene(parse_scene(example, "hill.toml")).axes for example in examples] == [1, 3, 1]


@pytest.mark.parametrize("spec", ["paper:", "paper:x", "paper:-1", "paper:1.5", "paper:" + "9" * 5000])
def test_a_seed_that_is_not_a_whole_number_is_refused(spec: str) -> None:
    with pytest.raises(SettingsError, match="seed"):
        find_scene(spec)
    with pytest.raises(SettingsError, match="-1"):
        paper_scene(-1)


def test_the_papers_scene_does_not_import_pydantic() -> None:
    code = "import hapticnet.scene.sources as p, sys; p.find_scene('paper'); print('pydantic' in sys.modules)"
    assert run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


T_US = np.array([5000, 6000, 8000])
FORCE_N = np.array([[1.0, 0.0], [2.0, -1.0], [3.0, 0.5]])


@pytest.mark.parametrize(
    ("since_us", "force_n"), [(999, (1.0, 0.0)), (1000, (2.0, -1.0)), (3000, (3.0, 0.5)), (3001, (0.0, 0.0))]
)
def test_the_force_passes_in_time_from_the_first_position_on(since_us, force_n):
    scene = RecordedScene(T_US, FORCE_N, name="it")
    assert scene.step(PositionSample(7_000_000, (0.0, 0.0))) == ForceSample(7_000_000, (1.0, 0.0))
    assert scene.step(PositionSample(7_000_000 + since_us, (0.1, 0.2))) == ForceSample(7_000_000 + since_us, force_n)


def test_each_master_feels_it_from_the_beginning(tmp_path):
    write_csv(tmp_path / "a.csv", {"t_us": T_US, "force_n": FORCE_N[:, 0]})
    source = find_source(f"recording:{tmp_path}/a.csv")
    source.prepare()
    first, second = source.make(), source.make()
    first.step(PositionSample(0, (0.0,)))
    assert first.step(PositionSample(1000, (0.0,))).force_n == (2.0,)
    assert second.step(PositionSample(1000, (0.0,))).force_n == (1.0,)
    assert (source.name, first.name, first.axes) == ("recording:a.csv", "recording:a.csv", 1)


def test_columns_can_be_chosen_and_a_name_may_have_a_colon(tmp_path):
    write_csv(tmp_path / "a:b.csv", {"t_us": T_US, "fx": FORCE_N[:, 0], "fy": FORCE_N[:, 1]})
    scene = find_source(f"recording:{tmp_path}/a:b.csv:fy").make()
    assert scene.step(PositionSample(0, (0.0,))).force_n == (0.0,)
    with pytest.raises(FileError, match="which column"):
        find_source(f"recording:{tmp_path}/a:b.csv")


def test_a_force_out_of_range_is_refused(tmp_path):
    write_csv(tmp_path / "a.csv", {"t_us": [0, 1], "force_n": [1e16, 0.0]})
    with pytest.raises(FileError, match=r"sample 0 is 1e\+16 N"):
        RecordedSource(tmp_path / "a.csv")


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
ring_hz = 200
ring_decay_per_s = 60.0
touch_per_s = 100.0
breach_m_s2 = 10.0

[[tissue]]
name = "front"
rest_position_m = 0.02
stiffness_n_per_m = 200.0
breach_force_n = 2.0
"""


def test_a_file_describes_tissues_by_their_attributes() -> None:
    front = Tissue(name="front", rest_position_m=0.02, stiffness_n_per_m=200.0, breach_force_n=2.0)
    lines = SCENE.split("[[tissue]]")[1].strip().splitlines()
    back = {key: float(value) for key, value in (line.split(" = ") for line in lines[1:])}
    assert ["name", *back] == [field.name for field in dataclasses.fields(Tissue)], "every attribute is a key"
    assert parse_scene(SCENE, "two.toml") == SceneSettings(name="two", tissues=(front, Tissue(name="back", **back)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("shaft_friction_n", "friction_n", r"tissue 1: unknown key 'friction_n' .*; the keys are .*shaft_friction_n"),
        ("breach_force_n = 2.0\n", "", r"tissue 2: breach_force_n is missing"),
        ("= 350", '= "350"', r"tissue 1: stiffness_n_per_m is '350'"),
        ("= 350", "= nan", r"tissue 'back': stiffness_n_per_m is nan"),
        ("= 350", "= 1" + "0" * 400, r"tissue 1: stiffness_n_per_m is 10+\.\.\.0+; "),
        ("= 0.04", "= 0.02", r"tissues 'back' and 'front' both rest at 0.02 m"),
        (SCENE, 'name = "none"\ntissue = []', r"the scene has no tissue"),
        (SCENE, 'name = "odd"\ntissue = 3', r"tissue is 3"),
        ("friction = 0.2", "friktion = 0.2", r"plane 1: unknown key 'friktion' \(did you mean 'friction'"),
        ("[0, 0.01]", "[0.01]", r"body 'ground': point_m is \[0.01\]; it must be 2 or 3 numbers"),
        ("[0, 0.01]", "0.01", r"plane 1: point_m is 0.01; it must be a list"),
        ("[0.01, 0.0]", "[0.01, 0.0, 0.0]", r"body 'ground' has 2 axes and body 'ball' 3"),
        ("radius_m = 0.005", "radius_m = -1", r"body 'ball': radius_m is -1"),
    ],
)
def test_a_mistake_is_reported_in_one_line_with_file_and_key(old: str, new: str, message: str) -> None:
    text = SCENE if old in SCENE else BODIES
    assert old in text
    with pytest.raises(SettingsError, match=r"^it\.toml: " + message) as caught:
        parse_scene(text.replace(old, new, 1), "it.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "a"\n[[tissue]\n', r"line 2, column 9"),
        ("a = " + "1" * 5000, r"digits"),
        ("a = " + "[" * 5000, r"recursion"),
    ],
)
def test_malformed_toml_is_refused_with_line_and_column(text: str, message: str) -> None:
    with pytest.raises(FileError, match=r"^bad\.toml: not a TOML file: .*" + message):
        parse_scene(text, "bad.toml")


def test_planes_and_spheres_are_read_with_their_vectors() -> None:
    hill = parse_scene(BODIES, "hill.toml")
    assert isinstance(hill, BodySceneSettings)
    assert hill.axes == 2
    assert hill.bodies == (
        Plane(name="ground", point_m=(0.0, 0.01), inward=(0.6, 0.8), stiffness_n_per_m=200.0, friction=0.2),
        Sphere(name="ball", centre_m=(0.01, 0.0), radius_m=0.005, stiffness_n_per_m=300.0),
    )


def test_tissues_and_bodies_in_one_scene_are_refused() -> None:
    with pytest.raises(SettingsError, match="2 tissues and 1 bodies"):
        parse_scene(SCENE + BODIES[BODIES.index("[[sphere]]") :], "both.toml")


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "odd.toml").write_bytes(b'name = "\xff"')
    (tmp_path / "folder.toml").mkdir()
    for name, why in (("none", "No such file"), ("odd", ""), ("folder", "directory")):
        with pytest.raises(FileError, match=rf"{name}\.toml.*{why}"):
            find_scene(f"{tmp_path}/{name}.toml")
