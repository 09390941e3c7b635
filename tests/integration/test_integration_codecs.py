"""A codec of a user in every verb that takes one, and a coupling of a package, with real processes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_cli_errors import REFUSED
from tests.codec.test_codec_plugins import GOOD
from tests.ready import ROOT, hapticnet


@pytest.fixture
def codec(tmp_path: Path) -> str:
    (tmp_path / "mine.py").write_text(GOOD)
    (tmp_path / "force.csv").write_text("t_s,f\n" + "".join(f"{n / 1000},{n % 17}\n" for n in range(1000)))
    return f"{tmp_path / 'mine.py'}:Mine"


def test_master_and_slave_speak_it_and_the_masters_parameters_count(start, serve, codec):
    server, address = serve("--json", "--add-codec", codec)
    master = start("master", "--connect", address, "--codec", f"{codec}:share=0.5", "--duration", "1", "--json")
    assert master.process.wait(30) == 0, master.said()
    assert server.end() == 0
    (session,) = server.report()["sessions"]
    assert session["codec"] == master.report()["codec"] == "mine"
    assert session["parameters"] == {"share": 0.5}
    assert session["packet_rate_reduction"] > 0.5


def test_a_slave_without_it_refuses_and_imports_nothing(start, slave, codec):
    server, address = slave
    master = start("master", "--connect", address, "--codec", codec, "--duration", "1")
    assert master.process.wait(30) == REFUSED
    assert "refused the session: unknown codec 'mine'; there are: raw, deadband" in master.said()
    assert server.end() == 0


def test_a_slave_serves_the_couplings_of_installed_packages(start, slave):
    server, address = slave
    options = "--coupling", "wave-variables:impedance=2", "--duration", "1", "--json"
    master = start("master", "--connect", address, *options)
    assert master.process.wait(30) == 0, master.said()
    assert master.report()["coupling"]["name"] == "wave-variables"
    assert server.end() == 0


@pytest.mark.usefixtures("codec")
def test_an_installed_package_offers_it_by_name(tmp_path):
    def installed(*arguments):
        """Run a command line where packages are installed in this folder."""
        path = {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
        command = [sys.executable, "-P", "-m", "hapticnet", *arguments]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=os.environ | path)

    package = tmp_path / "mine-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[hapticnet.codecs]\nmine = mine:Mine\ngone = gone:Gone\n")
    listed = installed("codecs", "--json")
    assert next(each for each in json.loads(listed.stdout) if each["name"] == "mine") == {
        "name": "mine",
        "summary": "Send each change that exceeds a share of the threshold.",
        "needs_position": False,
        "parameters": [{"name": "share", "default": 1.0, "meaning": "Of the threshold."}],
    }
    assert listed.stderr == "codecs: codec gone:Gone: cannot find gone\n"
    done = installed("compare", "force.csv", "--codecs", "mine:share=0", "--json")
    assert {row["sent"] for row in json.loads(done.stdout)["rows"]} == {1000}


@pytest.mark.usefixtures("codec")
@pytest.mark.parametrize("verb", ["compare force.csv", "demo", "master", "slave"])
def test_a_broken_one_is_refused_in_one_line(tmp_path, verb):
    (tmp_path / "mine.py").write_text(GOOD.replace("return self.held", "return self.hold"))
    option = {"compare force.csv": "--codecs", "slave": "--add-codec"}.get(verb, "--codec")
    done = hapticnet(*verb.split(), option, "mine.py:Mine", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert (
        "codec mine.py:Mine: a rehearsal with 1-axis forces raised AttributeError: 'Receiver' object has no"
        " attribute 'hold' (mine.py, line "
    ) in done.stderr


def test_a_slave_takes_no_parameters(codec):
    done = hapticnet("slave", "--add-codec", f"{codec}:share=2")
    assert done.returncode == 2
    assert "omit the parameters; each master sends its own" in done.stderr
