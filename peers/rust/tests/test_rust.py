"""The Rust crate: it builds without a warning, its examples over UDP and in real time, and sealed sessions."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from conformance.programs import check_felt, check_refused, check_slave, length_test, need, running_slave, write_keys
from conformance.session import SLAVE
from hapticnet.protocol.keys import format_key

HERE = Path(__file__).parents[1]
README = HERE / "README.md"


@pytest.fixture(scope="session")
def target(tmp_path_factory):
    need("cargo", "rustc", "gcc", "make")
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


def test_what_is_wrong_is_one_sentence(target):
    assert "5 passed" in cargo(target, "test", "--locked", "--test", "errors")


def test_a_master_feels_the_scene_of_a_slave_of_hapticnet(examples):
    with running_slave() as port:
        check_felt([examples / "master", f"127.0.0.1:{port}", 2])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("master", "nonsense"), "nonsense: "),
        (("master", "127.0.0.1:x"), "127.0.0.1:x: "),
        (("master", "127.0.0.1:99999"), "127.0.0.1:99999: "),
        (("master", "127.0.0.1:47800", "x"), "usage: master ["),
        (("slave", "x"), "usage: slave ["),
        (("slave", "99999"), "usage: slave ["),
    ],
)
def test_an_example_refuses_wrong_arguments_with_its_usage(examples, arguments, said):
    program, *wrong = arguments
    assert f"usage: {program} [" in check_refused([examples / program, *wrong], said)


def test_a_master_of_hapticnet_feels_the_spring_of_a_slave(examples):
    check_slave([examples / "slave"])


def test_with_the_line_of_the_readme_its_session_is_sealed_by_key_files_of_hapticnet(target, tmp_path):
    """As a user does: in a crate of its own, which depends on this one."""
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
    with running_slave(*write_keys(tmp_path)) as port, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", f"{tmp_path}/master")
        check_felt([target / "debug" / "sealed", f"127.0.0.1:{port}", 2])


test_an_example_is_short_and_its_length_is_in_the_readme = length_test(HERE, "*.rs", 55)


def test_the_code_of_the_readme_is_that_of_the_example():
    code = re.search(r"```rust\n(let mut.*?)```", README.read_text(), flags=re.DOTALL)[1]
    source = (HERE / "examples" / "master.rs").read_text()
    lines = [line.strip() for line in code.splitlines() if line.strip() and not line.startswith("//")]
    assert [line for line in lines if line not in source] == []
