"""TOML files that people give us are read or refused, whatever is in them, without much time or memory."""

import datetime
import importlib
import math
import pkgutil
import time
import tomllib
import tracemalloc

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from hapticnet.documents import LARGEST_DOCUMENT, MOST_PARTS, parse_document, parse_tables
from hapticnet.errors import FileError, HapticnetError

PARTS = ("a", "_-9", '"b c"', "'.'", '"\\"."', '""')
LONG_S = 20.0
"""Far more than what is linear takes, and far less than what is not."""


class Table(BaseModel):
    """A document with one key."""

    model_config = {"extra": "forbid"}
    a: int


@given(st.lists(st.sampled_from(PARTS), min_size=1, max_size=40), st.sampled_from([".", " . ", "\t.", ". "]))
@pytest.mark.parametrize(
    "form", ["{} = 1", "x = 1.5\n[{}]\ny = 1", "[[ {} ]]", "x = {{ {} = 1.5 }}", "x = [{{ {}=1 }}, 1.5]"]
)
def test_a_key_has_at_most_so_many_parts_wherever_it_stands(form, parts, dot):
    text = form.format(dot.join(parts))
    if len(parts) > MOST_PARTS:
        with pytest.raises(
            FileError, match=rf"^x: line [12] has a key of {len(parts)} parts; at most {MOST_PARTS} are"
        ):
            parse_tables(text, "x")
    else:
        assert parse_tables(text, "x") == tomllib.loads(text)


def test_numbers_times_and_text_are_no_keys():
    text = f'a = [{"0.25, " * 1000}1.5]\nb = "{".x" * 100}"\nc = 1979-05-27T07:32:00.999\n# {"a." * 100}a\n'
    assert parse_tables(text, "x") == tomllib.loads(text)


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ('"".', "has a key of"),
        ("x.a.b.c.d.e.f.g=1\n", "not a TOML file|dotted keys have more than 200,000 parts"),
        ("a . ", None),
        ("a ", None),
        ('"\\"', None),
        ("'\"", None),
        ("{a=", None),
        ("[", None),
        ("[[a]]\n", None),
    ],
)
def test_no_document_takes_long_or_much_memory(unit, message):
    text = unit * (2**20 // len(unit))
    tracemalloc.start()
    began = time.monotonic()
    try:
        with pytest.raises(HapticnetError, match=message):
            parse_document(text + "a=1", "x", Table)
        assert tracemalloc.get_traced_memory()[1] < 500 * 2**20
    finally:
        tracemalloc.stop()
    assert time.monotonic() - began < LONG_S


@pytest.mark.parametrize("text", ['a = "{}"', 'a = ["x", "{}"]', '[a.b]\nc = "{}"', '"{}" = 1', '[a."{}"]'])
@pytest.mark.parametrize("control", ["\\u0000", "\\u001b", "\\u007f", "\\u009b", "\\r"])
def test_a_control_character_in_a_text_or_key_is_refused(text, control):
    with pytest.raises(FileError, match=r"x: '.*' has the control character U\+00[0-9A-F]{2}; remove it") as caught:
        parse_tables(text.format(control), "x")
    assert str(caught.value).isprintable()


def test_line_feeds_tabs_and_every_script_are_allowed_in_texts():
    text = "two\nlines\tof é 力 \u00a0\u200d"
    assert parse_tables(f'a = """{text}"""', "x") == {"a": text}


def test_many_small_keys_are_refused_before_they_fill_the_memory():
    text = "".join(f"k{number}.a.b.c.d.e.f.g=1\n" for number in range(LARGEST_DOCUMENT // 24))
    with pytest.raises(FileError, match="its dotted keys have more than 200,000 parts together"):
        parse_tables(text, "x")


ROOMS = ("hapticnet.scene", "hapticnet.protocol", "hapticnet.sweep", "hapticnet.device")
"""Where documents are read."""

WRONG = (
    1, -1, 0, 1.5, -1.5, "x", "", "x" * 10_000, True, [], [1], ["x"], [1.5] * 5, [1] * 200, {}, {"x": 1}, [{}],
    math.nan, math.inf, -math.inf, 1e30, 10**18, datetime.date(2026, 1, 1), datetime.time(1, 2),
)  # fmt: skip

OF_THE_LIBRARY = (
    "Input", "should", "Extra", "permitted", "Field required", "Value error", "valid ", "instance", "something else",
)  # fmt: skip


def documents(*rooms):
    """Return the models in these packages."""
    for room in rooms:
        package = importlib.import_module(room)
        for module in pkgutil.iter_modules(package.__path__, f"{room}."):
            importlib.import_module(module.name)
    found, waiting = [], [BaseModel]
    while waiting:
        for each in waiting.pop().__subclasses__():
            waiting.append(each)
            if each.__module__.startswith(tuple(f"{room}." for room in rooms)):
                found.append(each)
    return found


def assert_in_our_words(models):
    messages = []
    for model in models:
        for key in (*model.model_fields, "unknown"):
            for value in WRONG:
                try:
                    parse_document(tomli_w.dumps({key: value}), "x.toml", model)
                except HapticnetError as error:
                    messages.append(str(error))
    assert len(messages) > 50 * len(models)
    for message in messages:
        assert message.startswith("x.toml: ")
        assert "\n" not in message
        assert not [words for words in OF_THE_LIBRARY if words in message], message


def test_a_mistake_is_told_in_our_words_whatever_it_is():
    """The library that checks documents has words for programmers, such as "Input should be a valid dictionary"."""
    models = documents(*ROOMS)
    assert len(models) >= 10
    assert_in_our_words(models)
