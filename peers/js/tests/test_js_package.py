"""The npm package: its own tests in Node, its size, its build, its examples and its README."""

import gzip
import json
import re
import shutil
import subprocess
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from conformance.child import Child, find_peers
from conformance.programs import check_felt, check_refused, check_slave, running_slave
from conformance.scenarios import AGAINST_DELAY
from conformance.script import Line, first_difference
from conformance.session import played

FLAGS = ["--experimental-global-webcrypto"]  # what Node 20 has without


def node(*arguments: object, **options: object) -> "subprocess.CompletedProcess[str]":
    command = ["node", *FLAGS, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


def test_the_tests_in_node_pass(package: Path):
    done = node("--test", package / "tests" / "package.test.mjs")
    assert done.returncode == 0, done.stdout


def test_the_package_is_no_larger_than_the_readme_says(package: Path):
    subprocess.run(["make", "-s", "pack"], cwd=package, check=True, capture_output=True)
    packed = json.loads(subprocess.check_output(["npm", "pack", "--dry-run", "--json"], cwd=package))[0]
    sizes = {file["path"]: file["size"] for file in packed["files"]}
    assert {"LICENSE", "THIRD-PARTY.md", "README.md", "package.json", "dist/index.d.ts"} < set(sizes)
    assert all(name.count("/") <= name.startswith("dist/") for name in sizes)
    module = (package / "dist" / "index.js").read_bytes()
    most = {"archive": packed["size"], "loaded": len(module), "compressed": len(gzip.compress(module))}
    readme = (package / "README.md").read_text()
    said = re.search(r"at most \*\*(\d+) kB\*\*; .* at most (\d+) kB \((\d+) kB with gzip\)", readme)
    assert said is not None
    for (name, size), kilobytes in zip(most.items(), said.groups(), strict=True):
        assert size <= 1000 * int(kilobytes), name


def test_two_builds_are_equal_to_the_byte(package: Path, tmp_path: Path):
    for name in ("c", "js"):
        leave = shutil.ignore_patterns("build", "dist", "node_modules", "tests")
        shutil.copytree(package.parent / name, tmp_path / name, ignore=leave)
    (tmp_path / "js" / "node_modules").symlink_to(package / "node_modules")
    subprocess.run(["make", "-s", "-C", tmp_path / "js"], check=True, capture_output=True)
    for path in (package / "dist").rglob("*.*"):
        again = tmp_path / "js" / path.relative_to(package)
        assert again.read_bytes() == path.read_bytes(), path.name


def test_the_lock_file_names_no_host(package: Path):
    assert "http" not in re.sub(r'"(url|funding)": "[^"]*"', "", (package / "package-lock.json").read_text())


GRANTS = {
    "few positions, announced, deadband": "1 0 1",
    "predicted, deadband": "0 1 0",
    "few positions, deadband": "1 0 0",
    "announced, perfect": "0 0 1",
}


@pytest.mark.parametrize("name", GRANTS)
def test_a_master_tells_what_was_granted_as_hapticnets_own_knows_it(package: Path, name: str):
    session = played(AGAINST_DELAY[name])
    in_force = session.recorder.node.in_force.history[-1][1]
    assert GRANTS[name] == f"{in_force.position_share > 0:d} {in_force.predicted:d} {in_force.announced:d}"
    start, rest = session.recorder.lines[:2], session.recorder.lines[2:]
    (peer,) = (each for each in find_peers() if each.folder == package)
    child = Child(peer, package / "build")
    script = [*start, Line("granted", "ok -"), *rest, Line("granted", f"ok {GRANTS[name]}")]
    try:
        assert first_difference(child, script) is None
    finally:
        assert child.end() == 0


@pytest.fixture
def slave() -> Iterator[str]:
    """Start a slave of hapticnet with the paper's scene; give its port."""
    with running_slave() as port:
        yield str(port)


@pytest.fixture
def project(package: Path, tmp_path: Path) -> Path:
    """Make a folder where `import "hapticnet"` gives what npm would install."""
    subprocess.run(["make", "-s", "pack"], cwd=package, check=True, capture_output=True)
    (archive,) = (package / "build").glob("hapticnet-*.tgz")
    with tarfile.open(archive) as files:
        files.extractall(tmp_path / "node_modules", filter="data")
    (tmp_path / "node_modules" / "package").rename(tmp_path / "node_modules" / "hapticnet")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    return tmp_path


def test_the_example_of_a_master_feels_the_scene_of_a_slave_of_hapticnet(package: Path, project: Path, slave: str):
    program = Path(shutil.copy(package / "examples" / "master.mjs", project))
    check_felt(["node", *FLAGS, program, "127.0.0.1", slave, 2], at_least=10)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("localhost",), "address is 'localhost'; it must be numeric, as 127.0.0.1"),
        (("127.0.0.1", "x"), "port is NaN; it must be 1 to 65535"),
        (("127.0.0.1", "99999"), "port is 99999; it must be 1 to 65535"),
    ],
)
def test_the_example_of_a_master_says_in_one_line_what_is_wrong(
    package: Path, project: Path, arguments: tuple[str, ...], said: str
):
    program = Path(shutil.copy(package / "examples" / "master.mjs", project))
    check_refused(["node", *FLAGS, program, *arguments], said)


def test_the_length_of_each_example_is_in_the_readme(package: Path):
    readme = (package / "README.md").read_text()
    for said, block in re.findall(r"\((\d+) lines\):\n\n```ts\n(.*?)```", readme, re.S):
        assert int(said) == sum(line.strip() != "" for line in block.splitlines())
    for example in sorted((package / "examples").iterdir()):
        lines = len(example.read_text().splitlines())
        assert f"(examples/{example.name}) ({lines} lines)" in readme


def blocks(package: Path) -> list[str]:
    """Return the programs of the README."""
    return re.findall(r"```ts\n(.*?)```", (package / "README.md").read_text(), re.S)


def test_the_first_program_of_the_readme_feels_the_scene(package: Path, project: Path, slave: str):
    (project / "first.mjs").write_text(blocks(package)[0].replace("47800", slave))
    with subprocess.Popen(["node", *FLAGS, project / "first.mjs"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        felt = (float(line) for line in process.stdout)
        assert next(force for force in felt if force > 1.0) < 5.0
        process.terminate()


def test_a_master_of_hapticnet_feels_the_slave_of_the_readme(package: Path, project: Path):
    (program,) = (block for block in blocks(package) if "serve(" in block)
    (project / "slave.mjs").write_text(program.replace("47800", "Number(process.argv[2])"))
    check_slave(["node", *FLAGS, project / "slave.mjs"], "a spring")


def test_the_examples_of_the_readme_have_the_types_of_the_package(package: Path, project: Path):
    """Each block of TypeScript is a module; it may use what `shared.d.ts` declares."""
    assert len(blocks(package)) >= 4
    for i, block in enumerate(blocks(package)):
        (project / f"block{i}.ts").write_text(block + "export {};\n")
    (project / "shared.d.ts").write_text(
        "declare module 'node:dgram' {\n"
        "  export function createSocket(kind: 'udp4'): import('hapticnet').Socket & { bind(port: number): void };\n"
        "}\n"
        "declare const nodeFs: { readFileSync(path: string, encoding: 'utf8'): string };\n"
        "declare module 'node:fs' { export const readFileSync: typeof nodeFs.readFileSync; }\n"
    )
    options = ["--noEmit", "--strict", "--target", "es2022", "--module", "nodenext", "--types"]
    files = [str(path) for path in sorted(project.glob("*.ts"))]
    done = node(package / "node_modules" / "typescript" / "bin" / "tsc", *options, "", *files, cwd=project)
    assert done.returncode == 0, done.stdout
