"""Each test runs with each peer that has a declaration: the fixture `child` is the running peer."""

import os

import pytest

from conformance.child import Child, find_peers
from conformance.script import dumps, loads
from conformance.session import played
from hapticnet.codec.registry import every_codec

every_codec()  # those of examples/literature, too
PEERS = find_peers()
RUNNING = {}


def pytest_collection_modifyitems(items):
    """Give time to the first test with a peer, which builds it."""
    for item in items:
        if "start" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.timeout(600))


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory):
    """A folder of this run, the same for all its processes."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session", autouse=True)
def ended():
    """End the peers at the end; each must end with 0 when its input does."""
    yield
    codes = {name: child.end() for name, child in RUNNING.items()}
    assert set(codes.values()) <= {0}, codes


@pytest.fixture(params=PEERS, ids=lambda peer: peer.folder.name)
def peer(request):
    """The declaration of a peer whose tools are here."""
    missing = ", ".join(request.param.missing())
    if missing and os.environ.get("CI"):
        pytest.fail(f"{request.param.name} needs {missing}; CI must have it")
    if missing:
        pytest.skip(f"{request.param.name} needs {missing}")
    return request.param


@pytest.fixture
def start(peer, shared_folder):
    """Return a function that starts the peer, or gives one that runs already."""
    build = peer.built(shared_folder / "peers")

    def started(number=1):
        name = f"{peer.folder.name} {number}"
        if name in RUNNING and not RUNNING[name].is_alive:
            RUNNING.pop(name).end()
        if name not in RUNNING:
            RUNNING[name] = Child(peer, build)
        return RUNNING[name]

    return started


@pytest.fixture
def child(start):
    return start()


@pytest.fixture
def note(peer, record_property):
    """Return a function that notes, for the table, how many of a kind agreed."""

    def noted(kind, count):
        record_property("agreement", f"{peer.folder.name} {kind} {count}")

    return noted


@pytest.fixture
def require(child):
    """Return a function that skips what a peer does not say that it has."""

    def required(scenario, role):
        codecs = "codecs" if role == "master" else "slave_codecs"
        lacks = [] if child.has(codecs, scenario.codec) else [scenario.codec]
        lacks += [] if child.has("roles", role) else [role]
        lacks += [] if scenario.key is None or child.has("sealed", role) else ["sealed sessions"]
        lacks += [] if scenario.axes <= int(child.features["axes"]) else [f"{scenario.axes} axes"]
        lacks += [each for each in scenario.also if not child.has("also", each)]
        if lacks:
            pytest.skip(f"{child.peer.name} has no {', '.join(lacks)}")

    return required


@pytest.fixture
def kept(shared_folder):
    """Return a function that gives the text of a file, made once for all peers and processes."""

    def text(kind, name, make):
        path = shared_folder / kind / f"{name.replace(' ', '_').replace(',', '')}.txt"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            part = path.with_suffix(f".{os.getpid()}")
            part.write_text(make())
            part.rename(path)
        return path.read_text()

    return text


@pytest.fixture
def script_of(kept):
    """Return a function that gives the script of a scenario."""
    return lambda name, scenario: loads(kept("scripts", name, lambda: dumps(played(scenario).recorder.lines)))


@pytest.fixture
def answers_of(kept):
    """Return a function that gives what hapticnet's slave answers, and its master applies, in a scenario."""
    return lambda name, scenario: kept("answers", name, lambda: "\n".join(played(scenario).answers())).split("\n")
