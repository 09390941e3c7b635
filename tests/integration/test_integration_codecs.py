"""A codec of a user in every verb that takes one, with real processes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_cli_errors import REFUSED
from tests.ready import ROOT, hapticnet

CODEC = '''
import struct
from dataclasses import dataclass, field
from typing import ClassVar
import hapticnet as hn

@dataclass(frozen=True)
class Every:
    """Send every so-manieth force.

    Attributes
    ----------
    step
        How many samples apart.
    """
    name: ClassVar[str] = "every"
    needs_position: ClassVar[bool] = False
    law: hn.WeberLaw = field(default_factory=hn.WeberLaw)
    step: float = 4.0

    def encoder(self, axes):
        return Sender(self.step, axes)

    def decoder(self, axes):
        return Holder(axes)

class Sender:
    def __init__(self, step, axes):
        self.step, self.axes, self.count = step, axes, 0

    def encode(self, t_us, stimulus, position=None):
        self.count += 1
        return struct.pack(f">{self.axes}d", *stimulus) if self.count % self.step == 1 else None

    def refresh(self):
        self.count = 0

class Holder:
    def __init__(self, axes):
        self.axes, self.held = axes, (0.0,) * axes

    def decode(self, t_us, payload):
        self.held = struct.unpack(f">{self.axes}d", payload)

    def reconstruct(self, t_us, position=None, position_us=None):
        return self.held
'''


@pytest.fixture
def codec(tmp_path: Path) -> str:
    (tmp_path / "every.py").write_text(CODEC)
    (tmp_path / "force.csv").write_text("t_s,f\n" + "".join(f"{n / 1000},{n % 17}\n" for n in range(1000)))
    return f"{tmp_path / 'every.py'}:Every"


def test_master_and_slave_speak_it_and_the_masters_parameters_count(start, serve, codec):
    server, address = serve("--json", "--add-codec", codec)
    master = start("master", "--connect", address, "--codec", f"{codec}:step=10", "--duration", "1", "--json")
    assert master.process.wait(30) == 0, master.said()
    assert server.end() == 0
    (session,) = server.report()["sessions"]
    assert session["codec"] == master.report()["codec"] == "every"
    assert session["parameters"] == {"step": 10.0}
    assert session["packet_rate_reduction"] == pytest.approx(0.9, abs=0.01)


def test_a_slave_without_it_refuses_and_imports_nothing(start, slave, codec):
    server, address = slave
    master = start("master", "--connect", address, "--codec", codec, "--duration", "1")
    assert master.process.wait(30) == REFUSED
    assert "refused the session: unknown codec 'every'; there are: raw, deadband" in master.said()
    assert server.end() == 0


@pytest.mark.usefixtures("codec")
def test_an_installed_package_offers_it_by_name(tmp_path):
    def installed(*arguments):
        """Run a command line where packages are installed in this folder."""
        path = {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
        command = [sys.executable, "-P", "-m", "hapticnet", *arguments]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=os.environ | path)

    package = tmp_path / "every-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: every\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[hapticnet.codecs]\nevery = every:Every\ngone = gone:Gone\n")
    listed = installed("codecs", "--json")
    assert next(each for each in json.loads(listed.stdout) if each["name"] == "every") == {
        "name": "every",
        "summary": "Send every so-manieth force.",
        "needs_position": False,
        "parameters": [{"name": "step", "default": 4.0, "meaning": "How many samples apart."}],
    }
    assert listed.stderr == "codecs: codec gone:Gone: cannot find gone\n"
    done = installed("compare", "force.csv", "--codecs", "every:step=5", "--json")
    assert {row["sent"] for row in json.loads(done.stdout)["rows"]} == {200}


@pytest.mark.usefixtures("codec")
@pytest.mark.parametrize("verb", ["compare force.csv", "demo", "master", "slave"])
def test_a_broken_one_is_refused_in_one_line(tmp_path, verb):
    (tmp_path / "every.py").write_text(CODEC.replace("return self.held", "return self.hold"))
    option = {"compare force.csv": "--codecs", "slave": "--add-codec"}.get(verb, "--codec")
    done = hapticnet(*verb.split(), option, "every.py:Every", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert (
        "codec every.py:Every: a rehearsal with 1-axis forces raised AttributeError: 'Holder' object has no"
        " attribute 'hold' (every.py, line 46)"
    ) in done.stderr


def test_a_slave_takes_no_parameters(codec):
    done = hapticnet("slave", "--add-codec", f"{codec}:step=2")
    assert done.returncode == 2
    assert "omit the parameters; each master sends its own" in done.stderr
