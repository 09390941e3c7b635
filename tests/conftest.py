"""What tests of several rooms share: both nodes in virtual time, the firmware and its simulator."""

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from xdist.scheduler import LoadScopeScheduling

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.keys import MasterEntry, Roster
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene
from tests.peers import ENTRY, KEY, OTHER_ENTRY, SLAVE

IN_CI = bool(os.environ.get("CI"))
FIRMWARE = Path(__file__).parents[1] / "firmware"

# Hundreds of tests start processes: without bytecode on disk, each would compile every module it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No deadlines: they would measure the machine. In CI the same examples every time; elsewhere new ones, which may find
# what nobody thought of; `pytest --hypothesis-profile thorough` for a long look.
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.register_profile("fresh", deadline=None)
hypothesis.settings.register_profile("thorough", deadline=None, max_examples=2000)
hypothesis.settings.load_profile("ci" if IN_CI else "fresh")

REAL_TIME = ("examples", "integration", "runtime", "systemd", "test_api_live.py", "web")
"""Where tests wait for processes, sockets and browsers."""

SHARED = ("bench", "firmware")
"""Where tests of several files share what takes long to make."""


class InGroups(LoadScopeScheduling):
    """Gives whole files to the workers of ``pytest -n``, and all tests in real time to one of them.

    So a test in real time shares the machine with at most the tests of the other workers, which wait for nothing.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        _, room, *within = file.split("/")
        return "real time" if {room, *within} & {*REAL_TIME} else room if room in SHARED else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> InGroups:
    """Let xdist distribute the tests in groups."""
    return InGroups(config, log)


def make_slave(
    seed: int = 1,
    *,
    make_scene: Callable[[Any], Any] | None = None,
    session: SessionSettings | None = None,
    sealed: bool | None = False,
    masters: Iterable[MasterEntry] = (ENTRY, OTHER_ENTRY),
    host_of: Callable[[Any], Hashable] = lambda address: address,
    rng: Any = None,
    **settings: Any,
) -> SlaveNode:
    """Return a slave of sealed or of open sessions, of both if `sealed` is None."""
    scene = paper_scene(seed)
    rng = rng or np.random.default_rng([seed, 10])
    doors: dict[int, Any] = {} if sealed else {OPEN: Door()}
    if sealed is not False:
        doors[SEALED] = SealedDoor(SLAVE.private, Roster(masters), rng)
    return SlaveNode(
        make_scene or (lambda _: Scene(scene.tissues, name=scene.name)),
        SlaveSettings(**{"record": True, "session": session or SessionSettings(), **settings}),
        rng,
        doors=doors,
        host_of=host_of,
    )


def make_master(
    seed: int = 1, *, settings: MasterSettings | None = None, device: bool = False, insertions: int = 1
) -> MasterNode:
    operator = ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng([seed, 11]))
    plant = SimulatedDevice(PlantSettings(), np.random.default_rng([seed, 12])) if device else None
    return MasterNode(operator, plant, settings or MasterSettings(record=True), np.random.default_rng([seed, 13]))


def linked(
    operator: Any,
    make_scene: Callable[[Any], Any] | None = None,
    forward: str = "perfect",
    feedback: str | None = None,
    *,
    device: Any = None,
    seed: int = 1,
    slave: dict[str, Any] | None = None,
    **settings: Any,
) -> Loopback:
    """Return both nodes, with this operator and scene; the channel back is as the one forward unless told."""
    return Loopback(
        MasterNode(operator, device, MasterSettings(**settings), np.random.default_rng([seed, 13])),
        make_slave(seed, make_scene=make_scene, sealed=None, **(slave or {})),
        forward=Emulator(parse_channel(forward), np.random.default_rng([seed, 14])),
        feedback=Emulator(parse_channel(feedback or forward), np.random.default_rng([seed, 15])),
    )


@pytest.fixture(params=[False, True], ids=["open", "sealed"])
def sealed(request: pytest.FixtureRequest) -> bool:
    """Whether sessions are sealed: a test with this argument runs for both versions."""
    return bool(request.param)


@pytest.fixture
def loopback() -> Callable[..., Loopback]:
    """Return a maker of both nodes in virtual time, joined by channels of the given specifications."""

    def make(
        seed: int = 1,
        *,
        forward: str = "perfect",
        feedback: str = "perfect",
        settings: MasterSettings | None = None,
        session: SessionSettings | None = None,
        device: bool = False,
        insertions: int = 1,
        start_us: int = 0,
        sealed: bool = False,
    ) -> Loopback:
        settings = settings or MasterSettings(record=True)
        if sealed:
            settings = replace(settings, key=KEY)
        return Loopback(
            make_master(seed, settings=settings, device=device, insertions=insertions),
            make_slave(seed, session=session, sealed=sealed),
            forward=Emulator(parse_channel(forward), np.random.default_rng([seed, 14])),
            feedback=Emulator(parse_channel(feedback), np.random.default_rng([seed, 15])),
            start_us=start_us,
        )

    return make


@pytest.fixture(scope="session")
def tool_is_missing() -> Callable[[str], None]:
    """Return what to call when a test's tool is missing: a failure in CI, a skip with a clear line elsewhere."""

    def missing(what: str) -> None:
        if IN_CI:
            pytest.fail(f"{what}; CI must have it")
        pytest.skip(what)

    return missing


@pytest.fixture(scope="session")
def make_firmware(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that builds a make target once and returns the build folder."""
    build = tmp_path_factory.mktemp("firmware")

    @functools.cache
    def run(target: str) -> Path:
        done = subprocess.run(["make", "-s", "-C", FIRMWARE, f"BUILD={build}", target], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        (build / f"{target}.log").write_text(done.stdout)
        return build

    return run


@pytest.fixture
def needs_toolchain(tool_is_missing: Callable[[str], None]) -> None:
    for tool, package in (("avr-gcc", "gcc-avr"), ("make", "make"), ("gcc", "gcc")):
        if shutil.which(tool) is None:
            tool_is_missing(f"{tool} is missing (package {package}), so the firmware cannot be built")
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        tool_is_missing("simavr is missing (packages libsimavr-dev and libelf-dev), so the firmware cannot be run")


@pytest.fixture
def simavr_files(request: pytest.FixtureRequest, make_firmware: Callable[..., Path]) -> tuple[Path, Path]:
    """Simulator and firmware as `simavr_build` would find them, but built here: the checkout's folder may be empty."""
    request.getfixturevalue("needs_toolchain")
    return make_firmware("sim") / "harness", make_firmware("firmware") / "firmware.elf"
