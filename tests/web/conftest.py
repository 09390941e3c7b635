"""A browser for the tests of the page; they are skipped where there is none."""

import shutil
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser

try:
    from playwright.sync_api import sync_playwright
except ImportError:  # playwright is not on every platform
    sync_playwright = None


@pytest.fixture(scope="module")
def chromium() -> "Iterator[Browser]":
    """Start the system's Chromium for the tests of a module.

    While playwright is started, its event loop counts as running in this thread, and no other can be run. So it ends
    with each module.
    """
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if sync_playwright is None or path is None:
        pytest.skip("needs playwright and Chromium: make chromium, and pip install -e '.[dev]'")
    with sync_playwright() as playwright:
        # The sandbox cannot be used as root, as in containers; these pages are our own.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()
