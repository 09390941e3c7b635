"""What is published, installed where nothing else is: clean Debian systems without compiler and network, CMake, npm."""

import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

import hapticnet
from release.clean_system import PYTHON_OF, download_wheels, make_base, missing_tools, run_inside
from release.source import ROOT

pytestmark = [pytest.mark.install, pytest.mark.timeout(600)]

PACKAGES = [
    "hapticnet",
    "hapticnet-literature",
    "hapticnet-experiment",
    "hapticnet-gateway",
    "hapticnet-mujoco",
    "hapticnet-ros2",
]


def build(out, **environment):
    command = [sys.executable, "-m", "release.build", "--quick", "--out", out]
    subprocess.run(command, check=True, cwd=ROOT, env=os.environ | environment, capture_output=True)
    return out


@pytest.fixture(scope="module")
def dist(tmp_path_factory, tool_is_missing):
    """Return a folder with what is published, except for what takes minutes to build."""
    for tool in ("git", "npm", "clang", "c++", "cmake", "pkg-config", "mono", "mcs", "cargo"):
        if shutil.which(tool) is None:
            tool_is_missing(f"no {tool}")
    return build(tmp_path_factory.mktemp("release") / "dist")


@pytest.fixture
def slave():
    """Return the port of a slave with the paper's scene."""
    with hapticnet.ThreadedSlave("paper:1", listen="127.0.0.1:0") as slave:
        yield slave.address.rpartition(":")[2]


def greatest_force(said):
    return max(float(force) for force in re.findall(r"(\d+\.\d+) N", said))


def test_a_second_build_elsewhere_gives_the_same_bytes(dist, tmp_path):
    umask = os.umask(0o077)
    try:
        again = build(tmp_path / "some" / "where" / "else", TZ="Asia/Tokyo", LC_ALL="C")
    finally:
        os.umask(umask)
    assert (again / "SHA256SUMS").read_text() == (dist / "SHA256SUMS").read_text()


def test_clean_systems_without_compiler_and_network_install_and_run_it(dist, tmp_path, tool_is_missing):
    if os.geteuid() != 0:
        pytest.skip("only root can make clean systems")
    for tool in missing_tools():
        tool_is_missing(f"no {tool}")

    def install(release):
        make_base(release)
        wheels, scratch = tmp_path / release, tmp_path / f"{release}-root"
        shutil.copytree(dist, wheels)
        scratch.mkdir()
        download_wheels(PACKAGES, PYTHON_OF[release], wheels)
        for folder in (tmp_path, *tmp_path.parents[:2]):
            folder.chmod(0o755)  # the program runs as nobody
        shutil.copy(ROOT / "release" / "try_installed.sh", wheels)
        demo = "demo" if release == "bookworm" else "no-demo"  # half a minute: once is enough
        return run_inside(release, wheels, f"sh -eu /wheels/try_installed.sh {demo} {' '.join(PACKAGES)}", scratch)

    with ThreadPoolExecutor() as pool:
        for said in pool.map(install, PYTHON_OF):
            assert f"hapticnet {hapticnet.__version__} (" in said
            assert json.loads(said[said.index("\n{") :])["end_reason"] == "done"


def unpack(dist, name, folder):
    subprocess.run(["tar", "xf", dist / f"hapticnet-{name}-{hapticnet.__version__}.tar.gz", "-C", folder], check=True)
    return folder / f"hapticnet-{name}-{hapticnet.__version__}"


def test_cmake_and_pkg_config_find_the_installed_c_library(dist, tmp_path, slave):
    source, prefix, consumer = unpack(dist, "c", tmp_path), tmp_path / "installed", tmp_path / "consumer"
    program = source / "examples" / "master"
    consumer.mkdir()
    (consumer / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(consumer C)\nfind_package(hapticnet 0.2 REQUIRED)\n"
        f"add_executable(master {program}.c)\ntarget_compile_definitions(master PRIVATE _DEFAULT_SOURCE)\n"
        "target_link_libraries(master hapticnet::hapticnet)\n"
    )
    for folder, last in ((source, ["--target", "install"]), (consumer, [])):
        options = [f"-DCMAKE_INSTALL_PREFIX={prefix}", f"-DCMAKE_PREFIX_PATH={prefix}"]
        subprocess.run(["cmake", "-S", folder, "-B", folder / "build", *options], check=True, capture_output=True)
        subprocess.run(["cmake", "--build", folder / "build", *last], check=True, capture_output=True)
    (described,) = prefix.rglob("hapticnet.pc")
    environment = os.environ | {"PKG_CONFIG_PATH": str(described.parent)}
    flags = subprocess.check_output(["pkg-config", "--cflags", "--libs", "hapticnet"], text=True, env=environment)
    flags = [*flags.split(), "-D_DEFAULT_SOURCE"]
    subprocess.run(["cc", f"{program}.c", *flags, "-o", tmp_path / "master"], check=True)
    subprocess.run(["c++", "-std=c++17", f"{program}.cpp", *flags, "-o", tmp_path / "master++"], check=True)
    for built in (consumer / "build" / "master", tmp_path / "master", tmp_path / "master++"):
        said = subprocess.check_output([built, "127.0.0.1", slave, "3"], text=True, timeout=20)
        assert greatest_force(said) > 1.0


@pytest.mark.parametrize(
    ("binding", "build", "master"),
    [
        ("csharp", "make -s examples", "mono build/SmallestMaster.exe 127.0.0.1 {port} 3"),
        ("rust", "cargo build -q --offline --example master", "target/debug/examples/master 127.0.0.1:{port} 3"),
    ],
)
def test_the_archive_of_a_binding_builds_a_master_that_feels_a_force(dist, tmp_path, slave, binding, build, master):
    folder = unpack(dist, binding, tmp_path) / binding
    subprocess.run(build.split(), check=True, cwd=folder)
    said = subprocess.check_output(master.format(port=slave).split(), text=True, timeout=60, cwd=folder)
    assert greatest_force(said) > 1.0


def test_npm_installs_the_package_offline_and_node_feels_a_force(dist, tmp_path, slave):
    packed = dist / f"hapticnet-{hapticnet.__version__}.tgz"
    subprocess.run(["npm", "install", "--offline", "--silent", packed], check=True, cwd=tmp_path)
    assert [path.name for path in (tmp_path / "node_modules").iterdir() if path.name[0] != "."] == ["hapticnet"]
    shutil.copy(ROOT / "peers" / "js" / "examples" / "master.mjs", tmp_path)
    said = subprocess.check_output(["node", "master.mjs", "127.0.0.1", slave, "3"], text=True, cwd=tmp_path)
    assert greatest_force(said) > 1.0
