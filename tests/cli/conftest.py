"""Run the command line within the test, which is faster than a process."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from hapticnet import cli
from hapticnet.runtime.nonblocking_log import STDERR, Form


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., CompletedProcess[str]]:
    """Return what runs a command line with environment variables of its own."""
    for name in list(os.environ):
        if name.startswith("HAPTICNET_"):
            monkeypatch.delenv(name)

    def command(*arguments: object, **environment: str) -> CompletedProcess[str]:
        with monkeypatch.context() as patch:
            patch.setattr(STDERR, "form", Form.PLAIN)
            patch.setattr(sys, "argv", ["hapticnet", *map(str, arguments)])
            for name, value in environment.items():
                patch.setenv(name, value)
            with pytest.raises(SystemExit) as end:
                cli.main()
        printed = capsys.readouterr()
        assert isinstance(end.value.code, int)
        return CompletedProcess(arguments, end.value.code, printed.out, printed.err)

    return command


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which this user's keys are kept; the environment names no key."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for name in ("HAPTICNET_KEY", "HAPTICNET_MASTERS", "HAPTICNET_PEER_KEY"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "config" / "hapticnet"
