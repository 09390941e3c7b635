"""The options that serve the live page."""

import socket
import sys
from pathlib import Path

import pytest

from hapticnet.cli import with_page_address
from hapticnet.cli.console import Console
from hapticnet.cli.demo import open_browser
from hapticnet.cli.pages import PAGE, address_in, address_of, choose_operator, say_addresses
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.runtime.processes import Child
from hapticnet.web.access import Access
from tests.cli.test_cli_errors import assert_only_line
from tests.ready import hapticnet


@pytest.mark.parametrize(
    ("written", "understood"),
    [
        ([], []),
        (["demo", "--page"], ["demo", "--page=auto"]),
        (["master", "--page", "127.0.0.1:9000"], ["master", "--page", "127.0.0.1:9000"]),
        (["master", "--page=[::1]:9000", "-q"], ["master", "--page=[::1]:9000", "-q"]),
    ],
)
def test_the_address_of_the_page_may_be_left_out(written: list[str], understood: list[str]):
    assert with_page_address(written) == understood


def test_the_page_is_the_operator_unless_another_is_named(capsys: pytest.CaptureFixture[str]):
    quiet = Console("master", quiet=True)
    assert choose_operator(None, None, quiet) == ("scripted", None)
    for operator, page, expected in (
        (None, "auto", "page"),
        ("page", None, "page"),
        ("scripted", "127.0.0.1:0", "scripted"),
    ):
        chosen, served = choose_operator(operator, page, quiet)
        assert chosen == expected
        assert served is not None
        served.close()
        said = capsys.readouterr().err
        for view in ("watch", "operator"):  # without them the page could not be opened
            assert f"/{view}.html" in said


def test_a_token_is_printed_on_a_terminal_and_stored_for_its_user_alone_elsewhere(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    """What is no terminal may be a log that others read, and all users can read the command line of a browser."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    access = Access("127.0.0.1", 47880)
    say_addresses({PAGE: "watch"}, access, Console("master", quiet=True))
    line = capsys.readouterr().err
    assert access.tokens["watch"] not in line
    file, passed_on = address_in(line)
    assert passed_on == line
    assert address_of(file) == access.url("watch")
    (folder,) = tmp_path.iterdir()
    assert folder.stat().st_mode & 0o077 == 0
    opened = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    assert open_browser(file)
    assert opened == [file]
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert access.url("watch") in address_in(line)[1]
    say_addresses({PAGE: "watch"}, access, Console("master", quiet=True))
    assert access.url("watch") in capsys.readouterr().err


def test_a_page_for_other_hosts_is_warned_about(capsys: pytest.CaptureFixture[str]):
    _, served = choose_operator(None, "0.0.0.0:0", Console("master"))
    assert served is not None
    served.close()
    said = capsys.readouterr().err
    assert f"http://{socket.gethostname()}:" in said
    assert "not encrypted" in said


def test_an_address_that_cannot_be_used_is_told_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UnavailableError, match=r"cannot serve the page at 127\..* in use"):
            choose_operator(None, address, Console("master", quiet=True))
    with pytest.raises(SettingsError, match="must be HOST:PORT"):
        choose_operator(None, "8080", Console("master", quiet=True))


def test_without_aiohttp_the_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "hapticnet.web.server", raising=False)
    monkeypatch.delitem(sys.modules, "hapticnet.web.client", raising=False)
    with pytest.raises(UnavailableError, match=r"pip install aiohttp"):
        choose_operator(None, "auto", Console("master", quiet=True))


def test_the_demo_on_the_page_writes_no_results():
    assert_only_line(hapticnet("demo", "--page", "--json"), "omit --out-dir and --json", code=2)


def test_a_page_of_too_few_axes_is_told_how_to_have_more():
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "phantom"])
    try:
        run = hapticnet("master", "--connect", slave.address(), "--page=127.0.0.1:0", "-q")
    finally:
        slave.end()
    assert "has 3; give the page as many with --operator page:axes=N" in run.stderr


def test_a_page_has_one_to_three_axes():
    run = hapticnet("master", "--operator", "page:axes=4")
    assert_only_line(run, "operator 'page:axes=4': expected page, page:axes=2 or page:axes=3")
