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

PACKAGES = ["hapticnet", "hapticnet-literature", "hapticnet-experiment", "hapticnet-mujoco", "hapticnet-ros2"]
INSTALL = f"""
for tool in cc gcc clang ld; do if command -v $tool; then exit 9; fi; done
python3 -m venv installed
. installed/bin/activate
pip install -q --no-index --find-links /shared {" ".join(PACKAGES)}
pip check -q
python -c 'import hapticnet_experiment, hapticnet_literature, hapticnet_mujoco, hapticnet_ros2'
hapticnet --version
hapticnet experiment --help
hapticnet codecs
hapticnet slave --scene paper:1 --listen 127.0.0.1:47800 --most-sessions 1 --report slave.json -q &
hapticnet master --connect 127.0.0.1:47800 --codec least-squares --insertions 1 --report master.json -q
kill -TERM $!
wait $!
hapticnet demo --insertions 1 --out-dir demo -q --json > demo.json
test -s demo/bytes_per_penetration.png
cat master.json
"""


def needs(missing):
    """Fail in CI, and skip elsewhere, if something is missing."""
    if missing and os.environ.get("CI") and missing[0] != "root":
        pytest.fail(f"{', '.join(missing)} missing; CI must have it")
    if missing:
        pytest.skip(f"{', '.join(missing)} missing")


def build(out, **environment):
    command = [sys.executable, "-m", "release.build", "--quick", "--out", out]
    subprocess.run(command, check=True, cwd=ROOT, env=os.environ | environment, capture_output=True)
    return out


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Return a folder with what is published, except for what takes minutes to build."""
    needs([tool for tool in ("git", "npm", "clang", "cmake", "pkg-config") if shutil.which(tool) is None])
    return build(tmp_path_factory.mktemp("release") / "dist")


@pytest.fixture
def slave():
    """Return the port of a slave with the paper's scene."""
    with hapticnet.ThreadedSlave("paper:1", listen="127.0.0.1:0") as slave:
        yield slave.address.rpartition(":")[2]


def greatest_force(said):
    return max(float(force) for force in re.findall(r"mm +(\S+) N", said))


def test_a_second_build_elsewhere_gives_the_same_bytes(dist, tmp_path):
    umask = os.umask(0o077)
    try:
        again = build(tmp_path / "some" / "where" / "else", TZ="Asia/Tokyo", LC_ALL="C", HOME=str(tmp_path))
    finally:
        os.umask(umask)
    assert (again / "SHA256SUMS").read_text() == (dist / "SHA256SUMS").read_text()


def test_clean_systems_without_compiler_and_network_install_and_run_it(dist, tmp_path):
    needs(missing_tools())

    def install(release):
        make_base(release)
        shared, scratch = tmp_path / release, tmp_path / f"{release}-root"
        shutil.copytree(dist, shared)
        scratch.mkdir()
        download_wheels(PACKAGES, PYTHON_OF[release], shared)
        for folder in (tmp_path, *tmp_path.parents[:2]):
            folder.chmod(0o755)  # the program runs as nobody
        return run_inside(release, shared, INSTALL, scratch)

    with ThreadPoolExecutor() as pool:
        for said in pool.map(install, PYTHON_OF):
            assert f"hapticnet {hapticnet.__version__} (" in said
            report = json.loads(said[said.index("\n{") :])
            assert report["end_reason"] == "done"


def test_cmake_and_pkg_config_find_the_installed_c_library(dist, tmp_path, slave):
    subprocess.run(["tar", "xf", dist / f"hapticnet-c-{hapticnet.__version__}.tar.gz", "-C", tmp_path], check=True)
    (source,) = tmp_path.iterdir()
    prefix, program = tmp_path / "installed", source / "examples" / "master.c"
    (tmp_path / "consumer").mkdir()
    (tmp_path / "consumer" / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(consumer C)\nfind_package(hapticnet 0.2 REQUIRED)\n"
        f"add_executable(master {program})\ntarget_compile_definitions(master PRIVATE _DEFAULT_SOURCE)\n"
        "target_link_libraries(master hapticnet::hapticnet)\n"
    )
    for folder in (source, tmp_path / "consumer"):
        built = folder / "build"
        options = [f"-DCMAKE_INSTALL_PREFIX={prefix}", f"-DCMAKE_PREFIX_PATH={prefix}"]
        subprocess.run(["cmake", "-S", folder, "-B", built, *options], check=True, capture_output=True)
        subprocess.run(["cmake", "--build", built], check=True, capture_output=True)
        if folder == source:
            subprocess.run(["cmake", "--install", built], check=True, capture_output=True)
    (described,) = prefix.rglob("hapticnet.pc")
    flags = subprocess.check_output(
        ["pkg-config", "--cflags", "--libs", "hapticnet"],
        text=True,
        env=os.environ | {"PKG_CONFIG_PATH": str(described.parent)},
    )
    subprocess.run(["cc", "-D_DEFAULT_SOURCE", program, *flags.split(), "-o", tmp_path / "master"], check=True)
    for built in (tmp_path / "master", tmp_path / "consumer" / "build" / "master"):
        said = subprocess.check_output([built, "127.0.0.1", slave, "1"], text=True, timeout=20)
        assert greatest_force(said) > 1.0


def test_npm_installs_the_package_offline_and_node_feels_a_force(dist, tmp_path, slave):
    packed = dist / f"hapticnet-{hapticnet.__version__}.tgz"
    subprocess.run(["npm", "install", "--offline", "--silent", packed], check=True, cwd=tmp_path)
    assert [path.name for path in (tmp_path / "node_modules").iterdir() if path.name[0] != "."] == ["hapticnet"]
    shutil.copy(ROOT / "peers" / "js" / "examples" / "master.mjs", tmp_path)
    said = subprocess.check_output(["node", "master.mjs", "127.0.0.1", slave, "2"], text=True, cwd=tmp_path)
    assert greatest_force(said) > 1.0
