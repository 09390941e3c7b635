"""The library, built once for all tests."""

from pathlib import Path
from typing import Any

import pytest

import peer


@pytest.fixture(scope="session")
def build_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("c")


@pytest.fixture(scope="session")
def lib(build_folder: Path) -> Any:
    return peer.load(peer.build(f"{build_folder}/shim.so", build_folder))
