"""How every Python process of ours is started, so that no file of the working folder takes the place of a module."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Environment variable with the effect of -P: Python does not search the working folder for modules."""


def python_command(*arguments: str) -> list[str]:
    """Return the command line of a Python process; `arguments` begin with -m and a module, or -c and a program.

    Without -P, both would search the working folder first: a user's queue.py there would be taken for Python's.
    """
    return [sys.executable, "-P", *arguments]


@contextmanager
def safe_path() -> Iterator[None]:
    """Have the same for what multiprocessing starts in this context: its command lines are not ours."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before
