"""Compilers, sanitizers and a microcontroller."""

import re
import subprocess

import pytest

import peer
from conformance.programs import need

CODE_BYTES, STATE_BYTES = 64 * 1024, 8 * 1024
SAID = re.compile(r"checksum (\w+)\), state of a master (\d+) bytes, of a slave (\d+) bytes")


def make(folder, *arguments):
    """Return what a target of the library prints."""
    command = ["make", "-s", "-C", peer.HERE, f"BUILD={folder}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_a_compiler_warns_of_nothing(tmp_path, compiler):
    need(compiler)
    make(tmp_path, f"CC={compiler}", "CFLAGS=-O1 -Werror", f"{tmp_path}/libhapticnet.a")


def test_damaged_datagrams_do_no_harm_under_sanitizers(tmp_path):
    """A short run, which reaches most of what a master does: `make fuzz` is the long one."""
    said = make(tmp_path, "CFLAGS=-O1 --coverage", "MILLISECONDS=8000", "fuzz")
    assert int(said.split()[0]) > 50_000
    for name in ("announced", "decoder", "few", "model", "more", "past", "receiving"):
        command = ["gcov", "--no-output", tmp_path / f"fuzz-{name}.gcda"]
        lines = re.search(r"^Lines executed:([\d.]+)%", subprocess.check_output(command, text=True), re.MULTILINE)
        assert float(lines[1]) > 80.0, name


def test_memory_that_does_not_fit_a_request_is_refused(tmp_path):
    make(tmp_path, f"{tmp_path}/memory")
    subprocess.run([tmp_path / "memory"], check=True)


def test_a_cortex_m_applies_the_same_forces_in_little_space(tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    here = SAID.search(subprocess.check_output([peer.build(f"{tmp_path}/both", tmp_path) / "both"], text=True))
    there = SAID.search(make(tmp_path, "emulate"))
    assert there[1] == here[1]
    sizes = subprocess.check_output(["arm-none-eabi-size", tmp_path / "both.elf"], text=True)
    code = int(sizes.splitlines()[1].split()[0])
    assert code <= CODE_BYTES
    assert all(int(state) <= STATE_BYTES for state in there.groups()[1:])
    readme = (peer.HERE / "README.md").read_text()
    said = re.search(
        r"(\d+) kB of code .* state of a master takes (\d+) bytes, that of a slave (\d+)", readme, re.DOTALL
    )
    assert said.groups()[1:] == there.groups()[1:]
    assert round(code / 1000) == int(said[1])
