"""Where the scenes of a slave come from."""

import gc

import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.samples import PositionSample
from hapticnet.scene.base import UserScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import as_touchable, find_scene, find_source

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
        (
            "nowhere",
            SettingsError,
            "unknown scene 'nowhere'; choose from paper, .*FILE.py:CLASS or package.module:CLASS",
        ),
        ("paper:red", SettingsError, "expected a whole number"),
        ("none.toml", FileError, "none.toml"),
        ("rig.py", SettingsError, r"name the class in the file too, as in rig.py:MyClass"),
        (
            "rig.py:Nothing",
            SettingsError,
            "rig.py defines no class 'Nothing'; it defines Spring, Robot, Sensitive, Closed",
        ),
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
