"""Classes of users: found in files and modules, made with options, and refused in one line."""

import itertools
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from hapticnet import user_code
from hapticnet.errors import HapticnetError, SettingsError, UserCodeError
from hapticnet.user_code import axes_of, failure, find_user_class, method_of, short, split_user_code, vector_from

RIG = """
calls = []

class Wall:
    def __init__(self, stiffness=100, **more):
        self.stiffness, self.more = stiffness, more

def make_wall():
    return Wall(7)

number = 3
"""


@pytest.fixture(autouse=True)
def in_a_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "path", sys.path[:])
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        del sys.modules[name]


def write(text, name="rig.py"):
    with open(name, "w") as file:
        file.write(text)


def test_a_class_in_a_file_is_made_with_its_options():
    write(RIG)
    found = find_user_class("rig.py:Wall:stiffness=250,gain=0.5,port=/dev/ttyUSB0:9600,fast=true,at=a.py:B", "scene")
    wall = found.make()
    assert (wall.stiffness, type(wall.stiffness)) == (250, int)
    assert wall.more == {"gain": 0.5, "port": "/dev/ttyUSB0:9600", "fast": True, "at": "a.py:B"}
    assert (found.label, str(found.file)) == ("scene rig.py:Wall", "rig.py")


def test_a_module_of_the_working_directory_is_found():
    write(RIG, "module_of_a_rig.py")
    assert find_user_class("module_of_a_rig:Wall", "scene").make().stiffness == 100
    os.mkdir("package_of_a_rig")
    write(RIG, "package_of_a_rig/parts.py")
    found = find_user_class("package_of_a_rig.parts:Wall:stiffness=1", "scene")
    assert (found.make().stiffness, found.file) == (1, None)


def test_the_classes_of_one_file_share_its_module_and_import_its_neighbours():
    write("", "neighbour_of_a_rig.py")
    write(f"import neighbour_of_a_rig\n{RIG}")
    first = user_code.load_user_code("rig.py:Wall", "scene")
    second = user_code.load_user_code("./rig.py:make_wall", "operator")
    assert second().stiffness == 7
    assert sys.modules[first.__module__] is sys.modules[second.__module__]


def test_files_of_one_name_in_two_folders_stay_apart_and_hide_no_module():
    for folder, stiffness in (("one", 1), ("two", 2)):
        os.mkdir(folder)
        write(RIG.replace("stiffness=100", f"stiffness={stiffness}"), f"{folder}/json.py")
    one, two = (user_code.load_user_code(f"{folder}/json.py:Wall", "scene") for folder in ("one", "two"))
    assert (one().stiffness, two().stiffness) == (1, 2)
    assert sys.modules[one.__module__] is not sys.modules[two.__module__]
    assert "one" not in sys.modules["json"].__file__


def test_an_edited_file_is_read_again_and_a_broken_edit_keeps_nothing():
    write(RIG)
    assert find_user_class("rig.py:Wall", "scene").make().stiffness == 100
    write(RIG.replace("100", "5"))
    os.utime("rig.py", ns=(1, 1))
    assert find_user_class("rig.py:Wall", "scene").make().stiffness == 5
    write("1 / 0")
    os.utime("rig.py", ns=(2, 2))
    for _ in range(2):
        with pytest.raises(SettingsError, match="raised ZeroDivisionError"):
            find_user_class("rig.py:Wall", "scene")


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("paper:1", None),
        ("scene.toml", None),
        ("a:b:c=d", ("a:b", "c=d")),
        ("dir/my own.py:Mine", ("dir/my own.py:Mine", "")),
        ("a.py:A:path=b.py:B", ("a.py:A", "path=b.py:B")),
    ],
)
def test_what_has_the_form_of_user_code(text, source):
    assert split_user_code(text) == source


@pytest.mark.parametrize(
    ("text", "content", "message"),
    [
        ("none.py:A", None, "operator none.py:A: cannot find none.py"),
        ("no.such.place:A", None, "operator no.such.place:A: cannot find no.such.place"),
        ("rig.py", RIG, "operator 'rig.py': name the class in the file too, as in rig.py:MyClass"),
        ("rig.py:Wal", RIG, "operator rig.py:Wal: rig.py defines no class 'Wal'; it defines Wall"),
        ("rig.py:number", RIG, "rig.py defines no class 'number'"),
        ("rig.py:Wall", "import nothing_of_the_kind", "importing rig.py raised ModuleNotFoundError: No module named"),
        ("rig.py:Wall", "class Wall\n", "importing rig.py raised SyntaxError: expected ':'"),
        ("rig.py:Wall", "\n1 / 0", r"raised ZeroDivisionError: division by zero \(rig.py, line 2\)"),
        ("rig.py:Wall", "import os\nos.open('none', 0)", "FileNotFoundError: .*line 2"),
        ("rig.py:Wall:stiffness", RIG, "'stiffness' must be KEY=VALUE, each key once, as in stiffness=200"),
        ("rig.py:Wall:a=1,a=2", RIG, "'a=2' must be KEY=VALUE, each key once"),
        ("rig.py:Wall:1=2", RIG, "'1=2' must be KEY=VALUE"),
        ("rig.py:make_wall:a=1", RIG, r"raised TypeError: make_wall\(\) got an unexpected keyword argument 'a'$"),
        ("rig.py:Wall", "class Wall:\n    def __init__(self):\n        exit(3)", "making it raised SystemExit: 3"),
        ("rig.py:Wall", "import asyncio\nraise asyncio.CancelledError", "raised asyncio.exceptions.CancelledError"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(text, content, message):
    if content is not None:
        write(content)
    with pytest.raises(SettingsError, match=message) as refused:
        find_user_class(text, "operator").make()
    assert str(refused.value).startswith("operator ")
    assert "\n" not in str(refused.value)


class Good:
    def step(self, _):
        return 0.0


async def slow(_):
    return 0.0


def many(_):
    yield 0.0


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (object(), r"it: has no method step\(sample\)"),
        (SimpleNamespace(step=3), r"it: has no method step\(sample\)"),
        (SimpleNamespace(step=lambda _, *, gain: gain), r"cannot call step\(sample\): missing a required .*: 'gain'"),
        (Good, r"it: cannot call step\(sample\): missing a required argument: '_'"),
        (SimpleNamespace(step=slow), "it: step is a coroutine or generator; it must be a plain method"),
        (SimpleNamespace(step=many), "it: step is a coroutine or generator; it must be a plain method"),
    ],
)
def test_a_method_that_cannot_be_called_is_refused(made, message):
    assert method_of(Good(), "step(sample)", "it")(None) == 0.0
    with pytest.raises(SettingsError, match=message):
        method_of(made, "step(sample)", "it")


@pytest.mark.parametrize("axes", [0, 4, -1, 2.0, "2", None, True])
def test_axes_are_a_whole_number_from_one_to_three(axes):
    good, bad = Good(), Good()
    good.axes, bad.axes = np.int64(3), axes
    assert (axes_of(good, "it"), axes_of(Good(), "it")) == (3, 1)
    with pytest.raises(SettingsError, match=r"it: axes is .*; it must be a whole number from 1 to 3"):
        axes_of(bad, "it")


@pytest.mark.parametrize(
    ("result", "vector"),
    [
        (1, (1.0,)),
        (np.float32(0.5), (0.5,)),
        (np.array(2.5), (2.5,)),
        ([1, 2.5], (1.0, 2.5)),
        (np.array([1.0, 2.0, 3.0]), (1.0, 2.0, 3.0)),
        ((each for each in (1, 2)), (1.0, 2.0)),
    ],
)
def test_numbers_and_sequences_become_vectors(result, vector):
    made = vector_from(result, len(vector), "Mine.step", "N")
    assert made == vector
    assert all(type(each) is float for each in made)


@pytest.mark.parametrize(
    "result",
    [
        None, "1", b"1", {"force": 1.0}, {1.0: 2.0}, (), (1.0, 2.0), [None], [[1.0]], float("nan"), float("inf"), 1e300,
        10**400, (float("nan"),), np.zeros((1, 2)), object(), 1j, ["a"],
        [1.0] * 1_000_000, itertools.count(),
    ],
)  # fmt: skip
def test_anything_else_is_refused_with_what_was_returned(result):
    for axes, words in ((1, "a finite number"), (3, "3 finite numbers")):
        with pytest.raises(UserCodeError, match=rf"^Mine.step returned [^\n]*; it must return {words} \[N\]$"):
            vector_from(result, axes, "Mine.step", "N")


def test_failures_name_method_and_line_and_let_ctrl_c_through():
    with pytest.raises(ValueError, match="no") as raised:
        exec(compile("\n\nraise ValueError('no\\nforce')", "own.py", "exec"))  # noqa: S102
    assert str(failure("Mine.step", raised.value)) == "Mine.step raised ValueError: no force (own.py, line 3)"
    assert str(failure("Mine.step", SystemExit(2))) == "Mine.step raised SystemExit: 2"
    assert isinstance(failure("Mine.step", SystemExit(2)), HapticnetError)
    with pytest.raises(KeyboardInterrupt):
        failure("Mine.step", KeyboardInterrupt())
    with ThreadPoolExecutor() as threads:  # where Ctrl-C never arrives
        told = threads.submit(failure, "Mine.step", KeyboardInterrupt()).result()
    assert str(told) == "Mine.step raised KeyboardInterrupt"


def test_no_exception_can_spoil_its_message():
    class RudeError(Exception):
        def __str__(self):
            raise SystemExit

    assert str(failure("Mine.step", RudeError())).endswith("RudeError: its message raised SystemExit")
    assert str(failure("Mine.step", ValueError("\x1b[2Jgone"))) == "Mine.step raised ValueError: ?[2Jgone"
    assert 900 < len(str(failure("Mine.step", ValueError("x" * 1_000_000)))) < 1100


def test_values_in_messages_are_short_whatever_they_are():
    class Rude:
        def __repr__(self):
            raise SystemExit

    assert short(Rude()) == "an object of type Rude"
    assert len(short("x" * 1000)) == 60
    assert short("a\nb") == r"'a\nb'"


def test_an_object_that_says_what_is_wrong_is_quoted_without_the_name_of_the_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.py").write_text(
        "import hapticnet as hn\ndef wall(size):\n    raise hn.SettingsError(f'size is {size}; at most 2')\n"
    )
    with pytest.raises(SettingsError, match=r"^scene rig.py:wall: size is 3; at most 2$"):
        find_user_class("rig.py:wall:size=3", "scene").make()
