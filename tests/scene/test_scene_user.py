"""Objects of the user's in the place of a scene."""

import pytest

from hapticnet.errors import SampleError, SettingsError, UserCodeError
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.base import UserScene


class Spring:
    def __init__(self, answer=lambda sample: 100.0 * sample.position_m[0], **attributes):
        self.answer = answer
        vars(self).update(attributes)

    def step(self, sample):
        return self.answer(sample)


AT = PositionSample(7, (0.01,))


def test_a_class_with_step_is_a_scene():
    scene = UserScene(Spring())
    assert scene.step(AT) == ForceSample(7, (1.0,))
    assert (scene.axes, scene.name, scene.breaches) == (1, "Spring", 0)


def test_it_may_declare_axes_name_and_breaches():
    scene = UserScene(Spring(lambda _: (0, 1, 2), axes=3, name="my robot", breaches=4))
    assert scene.step(PositionSample(0, (0.0, 0.0, 0.0))).force_n == (0.0, 1.0, 2.0)
    assert (scene.axes, scene.name, scene.breaches) == (3, "my robot", 4)
    assert UserScene(Spring(breaches="many")).breaches == 0


def test_the_force_answers_the_position_whatever_time_it_claims():
    assert UserScene(Spring(lambda _: ForceSample(99, (2.0,)))).step(AT) == ForceSample(7, (2.0,))


@pytest.mark.parametrize("name", ["", "a\nb", "x" * 65, 3, None])
def test_a_name_that_cannot_travel_is_refused(name):
    with pytest.raises(
        SettingsError, match=r"scene own.py:Spring: name is .*; it must be text, 1 to 64 printable bytes"
    ):
        UserScene(Spring(name=name), "scene own.py:Spring")


def test_a_wrong_result_is_an_error_of_the_user_and_so_is_a_sample_error():
    def refuse(_):
        raise SampleError("out of reach")

    for answer, message in (
        (lambda _: None, r"^Spring.step returned None; it must return a finite number \[N\]$"),
        (lambda _: ForceSample(0, (float("nan"),)), r"^Spring.step returned \(nan,\)"),
        (lambda _: 1 / 0, r"^Spring.step raised ZeroDivisionError: division by zero \(test_scene_user.py, line \d+\)$"),
        (lambda _: exit(1), r"^Spring.step raised SystemExit: 1"),
        (refuse, "^Spring.step raised SampleError: out of reach"),
    ):
        with pytest.raises(UserCodeError, match=message):
            UserScene(Spring(answer)).step(AT)


def test_properties_that_raise_are_told_and_breaches_never_disturb():
    class Rude(Spring):
        @property
        def breaches(self):
            raise SystemExit

        @property
        def axes(self):
            raise OSError("no such axis")

    with pytest.raises(SettingsError, match=r"scene own.py:Rude: reading axes raised OSError: no such axis \("):
        UserScene(Rude(), "scene own.py:Rude")
    Rude.axes = 1
    assert UserScene(Rude()).breaches == 0
