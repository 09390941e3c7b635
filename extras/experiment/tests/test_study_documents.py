"""Plans, texts and participants' files are read or refused, whatever is in them."""

import re

import pytest

from hapticnet.documents import parse_document
from hapticnet.errors import HapticnetError
from hapticnet_experiment.plan import LimitsPlan
from hapticnet_experiment.screens import Texts
from tests.test_documents import assert_in_our_words, documents


def test_a_mistake_is_told_in_our_words_whatever_it_is():
    models = documents("hapticnet_experiment")
    assert len(models) >= 8
    assert_in_our_words(models)


@pytest.mark.parametrize(
    ("model", "text", "value", "words"),
    [
        (LimitsPlan, "method = 'guess'", "'guess'", "'ascending' or 'up-down'"),
        (LimitsPlan, "catch = 1.5", "1.5", "at most 1.0"),
        (LimitsPlan, "largest = 0.0", "0.0", "more than 0.0"),
        (LimitsPlan, "references_n = []", "[]", "a list of at least 1"),
        (LimitsPlan, "catch = 'x'", "'x'", "a number"),
        (Texts, 'language = "en\\n"', r"'en\n'", "the tag of a language, such as 'en' or 'pt-BR'"),
    ],
)
def test_what_would_be_right_is_told_in_words(model, text, value, words):
    words = f"x.toml: {text.split()[0]} is {value}; it must be {words}"
    with pytest.raises(HapticnetError, match=f"^{re.escape(words)}$"):
        parse_document(text, "x.toml", model)
