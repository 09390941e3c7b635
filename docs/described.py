"""Let the page of the API show docstrings as `hapticnet.options.described` completes them."""

import importlib
import re
from typing import Any

import griffe


def type_text(kind: Any) -> str:
    """Return a type as one would write it."""
    text = kind.__name__ if isinstance(kind, type) else str(kind)
    return re.sub(r"\b(?:\w+\.)+", "", text)


class Described(griffe.Extension):
    """Take docstring and types of a decorated class from the class itself: its source has only a part of them."""

    def on_class(self, *, cls: griffe.Class, **kwargs: Any) -> None:  # noqa: ARG002
        """Replace the docstring that was read from the source."""
        if any(str(each.value) == "described" for each in cls.decorators):
            made = getattr(importlib.import_module(cls.module.path), cls.name)
            for name, field in made.__dataclass_fields__.items():
                if hasattr(field.type, "__origin__") and name in cls.attributes:
                    cls.attributes[name].annotation = type_text(field.type.__origin__)
            cls.docstring = griffe.Docstring(made.__doc__, parent=cls)
