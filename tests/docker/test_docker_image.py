"""What the image is made of, without an engine: versions with hashes, the extras, and an account that is not root."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
SERVICE = ["metrics", "record", "web", "fast"]


def name_of(requirement):
    return re.match(r"[A-Za-z0-9_.-]+", requirement)[0].lower().replace("_", "-")


def test_the_lock_has_each_dependency_of_its_extras_with_hashes_and_names_no_registry():
    text = (ROOT / "docker" / "locks" / "service.txt").read_text()
    pinned = dict(re.findall(r"^([a-z0-9.-]+)==(\S+)", text, re.MULTILINE))
    needed = [*PROJECT["dependencies"], *(each for extra in SERVICE for each in EXTRAS[extra]), "hatchling"]
    assert {name_of(each) for each in needed} <= pinned.keys()
    assert len(re.findall(r"^\S+==\S+.*\\\n    --hash=sha256:", text, re.MULTILINE)) == len(pinned)
    assert "://" not in text
    assert "index-url" not in text


def test_the_image_has_the_extras_of_a_service_and_takes_nothing_that_is_not_locked():
    assert f"ARG EXTRAS={','.join(SERVICE)}\n" in DOCKERFILE
    assert DOCKERFILE.index("ARG BASE=") < DOCKERFILE.index("FROM ${BASE}")
    installs = re.findall(r"pip install .*", DOCKERFILE)
    assert len(installs) == 2
    assert all("--no-deps" in each for each in installs)
    assert "--require-hashes" in installs[0]
    assert "--no-build-isolation" in installs[1]


def test_processes_of_the_image_are_not_root_and_gain_no_privileges():
    assert re.findall(r"^USER (.*)", DOCKERFILE, re.MULTILINE) == ["10001:10001"]
    services = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["services"]
    for service in services.values():
        assert service["cap_drop"] == ["ALL"]
        assert "cap_add" not in service
        assert service["security_opt"] == ["no-new-privileges:true"]


def test_real_time_scheduling_needs_no_capability():
    services = yaml.safe_load((ROOT / "docker" / "compose.realtime.yaml").read_text())["services"]
    assert services.keys() == yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["services"].keys()
    assert all(service == {"ulimits": {"rtprio": 10}} for service in services.values())
