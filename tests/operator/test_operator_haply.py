import json
import math

import pytest

from hapticnet.cli.operators import check_operator
from hapticnet.errors import PeerError, SettingsError
from hapticnet.operator.haply import ADDRESS, HaplyOperator, HaplySettings, parse_haply, read_state
from tests.runtime.inverse3 import state

PLACE = {"x": 0.1, "y": 0.2, "z": 0.3}


def message(**changes):
    return json.dumps(state(PLACE | changes))


def holding(**settings):
    """Return an operator that has held the tool for a second."""
    operator = HaplyOperator(HaplySettings(**settings))
    operator.receive(message(), 0)
    return operator


def applied(operator, force_n, now_us, step_us=1000):
    """Return the force [N] on x, y and z of the device, once this one was felt in the last two ticks."""
    for at_us in (now_us - step_us, now_us):
        operator.feel(at_us, force_n)
        operator.observe(at_us)
        [order] = json.loads(operator.command(at_us))["inverse3"]
    return tuple(order["commands"]["set_cursor_force"]["vector"].values())


def test_a_text_gives_address_and_settings():
    assert parse_haply("haply") == (ADDRESS, HaplySettings())
    text = "haply:[::1]:5,axes=3, axis = y,max-force=3,button=c"
    settings = HaplySettings(axes=3, axis="y", max_force_n=3.0, button="c")
    assert parse_haply(text) == ("[::1]:5", settings)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("haply,axess=2", r"has no 'axess' \(did you mean 'axes'\?\)"),
        ("haply,max-force=big", "'max-force=big' must be KEY=NUMBER"),
        ("haply,axes=nan", "'axes=nan' must be KEY=NUMBER"),
        ("haply,axes=4", "axes of the Inverse3 is 4"),
        ("haply,axis=w", "axis of the Inverse3 is 'w'; there are: x, y, z, -x"),
        ("haply,button=d", "button of the Inverse3 is 'd'; there are: a, b, c"),
        ("haply,max-force=20", "largest force of the Inverse3 is 20.0 N"),
        ("haply:here", "must be HOST:PORT"),
        ("hand:arm,motion=haply", "no hand intends 'haply'"),
    ],
)
def test_a_wrong_text_is_refused_in_a_sentence(text, words):
    with pytest.raises(SettingsError, match=words):
        check_operator(text)


@pytest.mark.parametrize("axis", ["x", "y", "z", "-x", "-y", "-z"])
def test_a_force_pushes_back_along_each_axis_of_the_tool(axis):
    forces = []
    for own in range(3):
        operator = holding(axes=3, axis=axis)
        force_n = applied(operator, tuple(0.1 * (each == own) for each in range(3)), 1_000_000)
        moved = {key: PLACE[key] + f for key, f in zip(PLACE, force_n, strict=True)}
        operator.receive(message(**moved), 1_000_000)
        assert operator.sample(0).position_m == pytest.approx([-0.1 * (each == own) for each in range(3)])
        forces.append(force_n)
    (a, b, c), (d, e, f), (g, h, i) = forces
    assert a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) == pytest.approx(-1e-3)  # right-handed
    assert forces[0]["xyz".index(axis[-1])] == pytest.approx(0.1 if axis.startswith("-") else -0.1)


def test_the_force_is_clamped_rises_slowly_falls_at_once_and_turns_through_zero():
    operator = holding(axes=2, axis="x")
    applied(operator, (0.0, 0.0), 1_000_000)
    sizes = [math.hypot(*applied(operator, (3.0, 4.0), 1_000_000 + 2000 * n)) for n in range(1, 20)]
    assert sizes[:3] == pytest.approx([0.4, 0.8, 1.2])
    assert sizes[-1] == pytest.approx(2.0)
    assert applied(operator, (0.03, 0.04), 1_040_000)[:2] == pytest.approx((-0.03, -0.04))
    assert applied(operator, (-3.0, -4.0), 1_042_000)[:2] == pytest.approx((0.24, 0.32))


def test_a_force_that_is_no_number_or_that_nobody_renews_is_zero():
    operator = holding()
    assert applied(operator, (math.nan,), 1_000_000) == applied(operator, (math.inf,), 1_002_000) == (0.0, 0.0, 0.0)
    assert applied(operator, (0.1,), 1_010_000)[2] == 0.1
    assert '"z": 0.1' in operator.command(1_060_000)
    assert '"z": 0.1' not in operator.command(1_110_000)


def test_the_tool_does_not_jump_after_the_button_or_a_fault():
    operator, now_us = holding(axis="x"), 0
    for let_go in (json.dumps(state(PLACE | {"x": 0.3}, button=True)), "{", message(x=math.nan)):
        now_us += 1_000_000
        operator.receive(message(x=0.11), now_us)
        at = operator.sample(0).position_m[0]
        assert applied(operator, (1.0,), now_us)[0] < 0.0
        operator.receive(let_go, now_us)
        assert applied(operator, (1.0,), now_us) == (0.0, 0.0, 0.0)
        operator.receive(message(x=-0.2), now_us)
        assert operator.sample(0).position_m[0] == pytest.approx(at)
        operator.receive(message(x=-0.19), now_us)
        assert operator.sample(0).position_m[0] == pytest.approx(at + 0.01)
    assert (operator.malformed, operator.faults) == (2, 2)


@pytest.mark.parametrize("place", [None, {"x": 0.0, "y": 0.0}, PLACE | {"z": True}, PLACE | {"z": "0"}, [1, 2, 3]])
def test_a_position_that_is_not_three_numbers_is_refused(place):
    with pytest.raises(PeerError, match="cursor_position"):
        read_state(json.dumps(state(place)), None, "a")
    for text in ("3", "[]", "{}", '{"inverse3": 3}', '{"inverse3": [3, {"device_id": 3}]}'):
        assert read_state(text, None, "a") is None


def test_wired_handles_and_older_services_are_understood():
    old = state(PLACE)
    del old["session_id"]
    old["verse_grip"] = [{"device_id": "5", "state": {"button": True}}]
    assert read_state(json.dumps(old), "049D", "a") == ("049D", (0.1, 0.2, 0.3), True)
    operator = HaplyOperator(HaplySettings())
    operator.receive(json.dumps(old), 0)
    assert '"set_cursor_force": {"values": {' in operator.command(0)
