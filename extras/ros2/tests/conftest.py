import itertools
import os

import pytest

numbers = itertools.count(1)


@pytest.fixture
def space():
    return f"/T{os.getpid()}_{next(numbers)}"  # other processes test beside this one


@pytest.fixture
def made():
    objects = []
    yield lambda found: objects.append(found) or found
    for each in objects:
        each.close()
