"""The C++ header: compilers, its examples over UDP and in real time, sealed sessions, and its installation."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from conformance.programs import (
    check_felt,
    check_refused,
    codec_names,
    free_port,
    length_test,
    need,
    running_slave,
    taken_port,
    write_keys,
)
from conformance.session import SLAVE
from hapticnet.protocol.keys import format_key

HERE = Path(__file__).parents[1]
README = HERE / "README.md"
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Wold-style-cast")


def make(folder, *arguments):
    need("g++", "make")
    done = subprocess.run(["make", "-s", "-C", HERE, f"BUILD={folder}", *arguments], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr[-3000:]


def compile_against(built, program):
    """Compile a program, as its source beside it has it."""
    paths = ["-I.", "-I../c/include", "-I../c/sealed"]
    libraries = [built / "c" / "libhapticnet_sealed.a", "-lcrypto", "-lm"]
    command = ["g++", "-std=c++17", *paths, f"{program}.cpp", *libraries, "-o", program]
    subprocess.check_call(command, cwd=HERE)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cpp")
    make(folder, "examples")
    return folder


def test_a_master_feels_the_scene_of_a_slave_of_hapticnet(built):
    with running_slave() as port:
        check_felt([built / "master", "127.0.0.1", port, 2])


def test_a_master_feels_the_spring_of_a_slave(built):
    port = str(free_port())
    with subprocess.Popen([built / "slave", port]) as slave:
        done = subprocess.run([built / "master", "127.0.0.1", port, "1"], capture_output=True, text=True, timeout=30)
        slave.terminate()
    forces = [float(n) for n in re.findall(r"([\d.-]+) N", done.stdout)]
    assert max(forces) == pytest.approx(3.0, rel=0.1)  # 300 N/m · 10 mm


def test_with_the_line_of_the_readme_its_session_is_sealed_by_key_files_of_hapticnet(built, tmp_path):
    line = re.search(r"^master\.seal\(.*\);$", README.read_text(), flags=re.MULTILINE)[0]
    line = line.replace("<the slave's public key>", format_key(SLAVE.public))
    source = (HERE / "examples" / "master.cpp").read_text()
    (tmp_path / "sealed.cpp").write_text(source.replace("master(request);", f"master(request);\n    {line}"))
    compile_against(built, tmp_path / "sealed")
    with running_slave(*write_keys(tmp_path)) as port, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", f"{tmp_path}/master")
        check_felt([tmp_path / "sealed", "127.0.0.1", port, 2])
        patch.setenv("XDG_CONFIG_HOME", f"{tmp_path}/nobody")
        done = subprocess.run([tmp_path / "sealed"], capture_output=True, text=True, timeout=30)
    assert done.returncode == 2
    assert done.stderr == f"{tmp_path}/nobody/hapticnet/key.toml does not exist; 'hapticnet key new' makes a key\n"


WRONG = """
#include "hapticnet.hpp"
#include <cstdio>
#include <type_traits>
static_assert(!std::is_copy_constructible_v<hapticnet::Master> && !std::is_move_constructible_v<hapticnet::Master>);
static_assert(!std::is_copy_assignable_v<hapticnet::Slave> && !std::is_move_assignable_v<hapticnet::Slave>);
template <class Make> void say(Make make)
{
    try {
        make();
        std::puts("fine");
    } catch (const hapticnet::Error &error) {
        std::puts(error.what());
    }
}
int main()
{
    say([] { hapticnet::Request r; r.rate_hz = 5.0; hapticnet::Master m(r); });
    say([] { hapticnet::Request r; r.codec = "deadbnad"; hapticnet::Master m(r); });
    say([] { hapticnet::Request r; r.parameters = {{"step_n", 2.0}}; hapticnet::Master m(r); });
    say([] { hapticnet::Request r; r.parameters = {{"step_n", 0.5}, {"stepn", 0.5}}; hapticnet::Master m(r); });
    say([] { hapticnet::Request r; r.floor_n = -1.0; hapticnet::Master m(r); });
    say([] { hapticnet::Request r; r.parameters.assign(6, {"step_n", 0.5}); hapticnet::Master m(r); });
    say([] { hapticnet::Request r; r.parameters = {{"step_n", 0.5}}; hapticnet::Master m(r); });
    say([] { hapticnet::Slave s("spring", 4); });
    say([] { hapticnet::Slave s(std::string(65, 'x')); });
    say([] { hapticnet::parse_key("abc"); });
    say([] { hapticnet::Master m(hapticnet::Request{}); m.seal(hapticnet::PrivateKey(hapticnet::Key{1}), {}); });
    say([] {
        hapticnet::Master m(hapticnet::Request{});
        m.tick(hapticnet::now());
        m.seal(hapticnet::PrivateKey(hapticnet::Key{1}), hapticnet::Key{9});
    });
}
"""


def test_what_is_wrong_is_an_error_with_the_text_of_the_library(built, tmp_path):
    (tmp_path / "wrong.cpp").write_text(WRONG)
    compile_against(built, tmp_path / "wrong")
    said = subprocess.check_output([tmp_path / "wrong"], text=True).splitlines()
    assert said == [
        "rate_hz is 5; it must be between 20 and 100000",
        f"codec is 'deadbnad'; it must be one of {', '.join(codec_names())}",
        "step_n is 2; it must be 0 or between 1e-12 and 1",
        "parameter is 'stepn'; it must be one of deadband's: step_n",
        "floor_n is -1; it must be 0 or between 1e-12 and 1e+09",
        "parameters has 6 entries; a codec has at most 5",
        "fine",
        "axes is 4; it must be 1 to 3",
        f"scene is '{'x' * 65}'; it must be at most 64 bytes of printable UTF-8",
        "a key is 44 characters of base64 that end in '=' (32 bytes); this has 3 characters",
        "the slave's public key is none; 'hapticnet key public' prints it on the slave's host",
        "a master is sealed once, before its first tick",
    ]


@pytest.mark.parametrize("sealed", ["", "-I../c/sealed"])
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_a_compiler_warns_of_nothing(compiler, sealed):
    need(compiler)
    flags = [*WARNINGS, "-std=c++17", "-Werror", "-fsyntax-only"]
    sources = [*HERE.glob("examples/*.cpp"), HERE / "tests" / "adapter.cpp"]
    done = subprocess.run(
        [compiler, *flags, "-I.", "-I../c/include", *sealed.split(), *sources], cwd=HERE, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_it_is_installed_with_the_c_library_and_found_by_pkg_config(tmp_path):
    need("cmake", "pkg-config")
    quiet = {"stdout": subprocess.DEVNULL}
    subprocess.check_call(
        ["cmake", "-S", HERE.parent / "c", "-B", tmp_path / "b", f"-DCMAKE_INSTALL_PREFIX={tmp_path}/i"], **quiet
    )
    subprocess.check_call(["cmake", "--build", tmp_path / "b"], **quiet)
    subprocess.check_call(["cmake", "--install", tmp_path / "b"], **quiet)
    folder = next((tmp_path / "i").rglob("hapticnet.pc")).parent
    flags = subprocess.check_output(
        ["pkg-config", "--cflags", "--libs", "hapticnet"], env=os.environ | {"PKG_CONFIG_PATH": str(folder)}, text=True
    )
    example = HERE / "examples" / "slave.cpp"
    subprocess.check_call(["g++", "-std=c++17", example, *flags.split(), "-o", tmp_path / "slave"])
    with taken_port() as port:
        done = subprocess.run([tmp_path / "slave", str(port)], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (2, "this port is taken; name another one\n")


@pytest.mark.parametrize(
    "arguments",
    [
        ("master", "127.0.0.1", "x"),
        ("master", "127.0.0.1", "99999"),
        ("master", "nonsense"),
        ("master", "::1"),
        ("master", "127.0.0.1", "47800", "x"),
        ("master", "127.0.0.1", "47800", "nan"),
        ("slave", "x"),
        ("slave", "99999"),
    ],
)
def test_an_example_refuses_wrong_arguments_with_its_usage(built, arguments):
    program, *wrong = arguments
    check_refused([built / program, *wrong], f"usage: {program} [")


test_an_example_is_short_and_its_length_is_in_the_readme = length_test(HERE, "*.cpp", 50)


def test_the_code_of_the_readme_is_that_of_the_example():
    code = re.search(r"```cpp\n(#include.*?)```", README.read_text(), flags=re.DOTALL)[1]
    lines = {re.sub(r"\s*//.*", "", line).strip() for line in code.splitlines()}
    source = (HERE / "examples" / "master.cpp").read_text()
    strange = [line for line in lines if line and line not in source and "..." not in line]
    assert strange == []
