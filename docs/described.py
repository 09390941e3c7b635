"""Let the page of the API show docstrings as `hapticnet.options.described` completes them."""

import importlib
from typing import Any

import griffe


class Described(griffe.Extension):
    """Take the docstring of a decorated class from the class itself, because its source has only a part of it."""

    def on_class(self, *, cls: griffe.Class, **kwargs: Any) -> None:  # noqa: ARG002
        """Replace the docstring that was read from the source."""
        if any(str(each.value) == "described" for each in cls.decorators):
            made = getattr(importlib.import_module(cls.module.path), cls.name)
            cls.docstring = griffe.Docstring(made.__doc__, parent=cls)
