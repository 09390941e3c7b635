"""The Rust crate: it builds without a warning, its examples over UDP and in real time, and sealed sessions."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import format_key
from tests.peers import ENTRY, MASTER, SLAVE

HERE = Path(__file__).parents[1]
README = HERE / "README.md"
LINES = 55


@pytest.fixture(scope="session")
def target(tmp_path_factory):
    missing = [tool for tool in ("cargo", "rustc", "gcc", "make") if shutil.which(tool) is None]
    if missing and os.environ.get("CI"):
        pytest.fail(f"{', '.join(missing)} missing; CI must have it")
    if missing:
        pytest.skip(f"{', '.join(missing)} missing")
    return tmp_path_factory.mktemp("rust")


def cargo(target, *arguments, cwd=HERE):
    command = ["cargo", *arguments, "--quiet", "--offline", "--target-dir", target]
    done = subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, env=os.environ | {"RUSTFLAGS": "-D warnings"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def examples(target):
    cargo(target, "build", "--locked", "--examples")
    return target / "debug" / "examples"


@contextmanager
def running_slave(*options):
    """Run a slave of hapticnet, and give its address."""
    command = [sys.executable, "-m", "hapticnet", "slave", "--scene", "paper", "--listen", "127.0.0.1:0", *options]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        addresses = (re.search(r"listening on (127\.0\.0\.1:\d+)", line) for line in process.stderr)
        try:
            yield next(address[1] for address in addresses if address)
        finally:
            process.terminate()


def check_felt(program, address):
    """Check that a master feels nothing before the tissue, and that it feels its skin."""
    done = subprocess.run([program, address, "2"], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (0, "")
    felt = [(float(x), float(n)) for x, n in re.findall(r"([\d.]+) mm +([\d.-]+) N", done.stdout)]
    assert len(felt) >= 20
    assert all(abs(n) < 0.1 for x, n in felt if x < 10.0)
    assert max(n for _, n in felt) > 3.0


def test_what_is_wrong_is_one_sentence(target):
    assert "5 passed" in cargo(target, "test", "--locked", "--test", "errors")


def test_a_master_feels_the_scene_of_a_slave_of_hapticnet(examples):
    with running_slave() as address:
        check_felt(examples / "master", address)
    done = subprocess.run([examples / "master", "nonsense"], capture_output=True, text=True, timeout=30)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)


def test_a_master_of_hapticnet_feels_the_spring_of_a_slave(examples):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with subprocess.Popen([examples / "slave", str(port)]) as slave:
        command = [sys.executable, "-m", "hapticnet", "master", "--connect", f"127.0.0.1:{port}", "--json"]
        done = subprocess.run([*command, "--duration", "3"], capture_output=True, text=True, timeout=60)
        slave.terminate()
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["scene"], report["connections"], report["received"]["malformed"]) == ("spring", 1, 0)


def test_with_the_line_of_the_readme_its_session_is_sealed_by_key_files_of_hapticnet(target, tmp_path):
    """As a user does: in a crate of its own, which depends on this one."""
    write_key(tmp_path / "master" / "hapticnet" / "key.toml", MASTER)
    write_key(tmp_path / "key.toml", SLAVE)
    (tmp_path / "masters.toml").write_text(dump_master(ENTRY))
    line = re.search(r"^master\.seal\(.*\)\?;$", README.read_text(), flags=re.MULTILINE)[0]
    line = line.replace("<the slave's public key>", format_key(SLAVE.public))
    source = (HERE / "examples" / "master.rs").read_text()
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "main.rs").write_text(source.replace("None)?;\n", f"None)?;\n    {line}\n", 1))
    (tmp_path / "Cargo.toml").write_text(
        '[package]\nname = "sealed"\nversion = "1.0.0"\nedition = "2021"\n'
        f'[dependencies]\nhapticnet = {{ path = "{HERE}" }}\n'
    )
    cargo(target, "build", cwd=tmp_path)
    keys = "--key", tmp_path / "key.toml", "--masters", tmp_path / "masters.toml"
    with running_slave(*keys) as address, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", f"{tmp_path}/master")
        check_felt(target / "debug" / "sealed", address)


@pytest.mark.parametrize("example", sorted((HERE / "examples").glob("*.rs")), ids=lambda path: path.stem)
def test_an_example_is_short_and_its_length_is_in_the_readme(example):
    lines = len(example.read_text().splitlines())
    assert lines <= LINES
    assert f"[examples/{example.name}](examples/{example.name}) ({lines} lines)" in README.read_text()


def test_the_code_of_the_readme_is_that_of_the_example():
    code = re.search(r"```rust\n(let mut.*?)```", README.read_text(), flags=re.DOTALL)[1]
    source = (HERE / "examples" / "master.rs").read_text()
    lines = [line.strip() for line in code.splitlines() if line.strip() and not line.startswith("//")]
    assert [line for line in lines if line not in source] == []
