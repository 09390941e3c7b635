"""A user's folder may hold files with the names of modules: no process takes them for Python's, a package's or ours."""

import re
import subprocess
import sys
import urllib.request
from contextlib import suppress
from pathlib import Path

import pytest

import hapticnet
from hapticnet.recordings.session.reading import read_session
from tests.ready import PATIENCE_S, wait_until

ROOT = Path(hapticnet.__file__).parents[1]
PACKAGES = ("numpy", "msgpack", "mcap", "prometheus_client", "typer", "uvloop", "pyarrow", "numba", "hapticnet", "nt")
TAKEN = "a file of the working folder was run"
STUDY = """
name = "Few"
[axes]
codec = ["deadband"]
loss = [0, "2%"]
"""


@pytest.fixture
def hostile(tmp_path, monkeypatch) -> Path:
    """Return a working folder with a file for the name of every module; each ends the process that runs it."""
    for name in {*sys.stdlib_module_names, *PACKAGES}:
        (tmp_path / f"{name}.py").write_text(f"import os\nos.write(2, b'{TAKEN}')\nos._exit(0)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return tmp_path


def command(*arguments: object) -> list[str]:
    """Return a command line that searches for modules where the command ``hapticnet`` does."""
    script = Path("bin", "hapticnet")
    script.parent.mkdir(exist_ok=True)
    script.write_text("from hapticnet.__main__ import main\nif __name__ == '__main__': main()\n")
    return [sys.executable, str(script), *map(str, arguments)]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command(*arguments), capture_output=True, text=True, check=False)
    assert TAKEN not in done.stderr
    assert done.returncode == 0, done.stderr
    return done


def answer_of(url: str) -> str:
    with suppress(OSError):  # it does not answer yet
        return urllib.request.urlopen(url, timeout=PATIENCE_S).read().decode()
    return ""


def test_the_processes_beside_a_master_and_a_slave_do_their_work(hostile):
    """Those that write recordings, serve metrics and stream samples; and a slave that is the child of another verb."""
    said = hostile / "said.txt"
    options = ("--listen", "127.0.0.1:0", "--no-real-time", "--record-dir", "slave", "--record-format", "mcap")
    with (
        said.open("w") as log,
        subprocess.Popen(command("slave", *options, "--metrics", "127.0.0.1:0"), stderr=log) as slave,
    ):
        try:
            address = wait_until(lambda: re.search(r"listening on (\S+),", said.read_text()))[1]
            metrics = wait_until(lambda: re.search(r"http://\S+/metrics", said.read_text()))[0]
            play = ("--no-real-time", "--record", "run.csv", "--duration", "1")
            run("master", "--connect", address, *play)
            wait_until(lambda: "hapticnet_" in answer_of(metrics))
        finally:
            slave.terminate()
    assert slave.returncode == 0, said.read_text()
    assert TAKEN not in said.read_text()
    assert len(read_session(hostile / "run.csv").main["t_us"]) > 100
    (recorded,) = (hostile / "slave").glob("*.mcap")
    assert len(read_session(recorded).main["t_us"]) > 100


def test_the_workers_of_a_sweep_compute(hostile):
    (hostile / "study.toml").write_text(STUDY)
    run("sweep", "study.toml", "--out-dir", "results", "--jobs", "2")
    assert list((hostile / "results").glob("shard-*.parquet"))


def test_python_m_hapticnet_takes_no_modules_of_the_folder(hostile):
    own = subprocess.check_output(
        [sys.executable, "-I", "-c", "import runpy, typing, sys; print(*sys.modules)"], text=True
    )
    for name in {*own.split(), "hapticnet"}:  # these Python loads before the first line of ours
        (hostile / f"{name}.py").unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-m", "hapticnet", "scene", "show"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, TAKEN in done.stderr) == (0, False), done.stderr


def test_one_place_in_the_code_starts_python():
    """`doctor` shows the path of Python in what it advises."""
    users = {
        str(file.relative_to(ROOT / "hapticnet"))
        for file in (ROOT / "hapticnet").rglob("*.py")
        if "sys.executable" in file.read_text()
    }
    assert users == {"runtime/processes.py", "runtime/doctor.py"}
