"""The package, built once for all tests, and a browser."""

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from conformance.programs import need

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser

HERE = Path(__file__).parents[1]
NEEDS = ("make", "clang", "wasm-ld", "node", "npm")


@pytest.fixture(scope="session")
def package() -> Path:
    """Return the folder of the package, built."""
    need(*NEEDS)
    done = subprocess.run(["make", "-s", "-C", HERE], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return HERE


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """Start Chromium; its event loop counts as running in this thread, so it ends with each module."""
    need("chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # The sandbox cannot be used as root, as in containers; these pages are our own.
        started = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        yield started
        started.close()
