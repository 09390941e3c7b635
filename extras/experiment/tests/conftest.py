"""Fixtures of hapticnet's own tests that these use, too."""

from tests.cli.conftest import home, run
from tests.conftest import make_firmware, needs_toolchain, simavr_files, tool_is_missing
from tests.web.conftest import chromium

__all__ = ("chromium", "home", "make_firmware", "needs_toolchain", "run", "simavr_files", "tool_is_missing")
