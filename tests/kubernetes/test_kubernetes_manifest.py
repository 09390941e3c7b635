"""The manifest agrees with the command line, with itself, and with what a slave needs."""

from pathlib import Path

import pytest
import typer
import yaml

from tests.cli.test_cli_help import ROOT_COMMAND

FILE = Path(__file__).parents[2] / "docker" / "kubernetes" / "slave.yaml"
OBJECTS = {(each["kind"], each["metadata"]["name"]): each for each in yaml.safe_load_all(FILE.read_text())}
SLAVES = OBJECTS["StatefulSet", "hapticnet-slave"]["spec"]
POD = SLAVES["template"]["spec"]
(SLAVE,) = POD["containers"]
OPTIONS = dict(each.removeprefix("--").partition("=")[::2] for each in SLAVE["args"][1:])


def test_the_slave_is_started_with_options_that_exist():
    assert SLAVE["args"][0] == "slave"
    command = ROOT_COMMAND.get_command(typer.Context(ROOT_COMMAND), "slave")
    known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
    assert {f"--{name}" for name in OPTIONS} <= known


def test_ports_of_options_container_services_and_annotations_agree():
    ports = {port["name"]: port for port in SLAVE["ports"]}
    assert OPTIONS["listen"] == f"0.0.0.0:{ports['session']['containerPort']}"
    assert OPTIONS["metrics"] == f"0.0.0.0:{ports['metrics']['containerPort']}"
    annotations = SLAVES["template"]["metadata"]["annotations"]
    assert annotations["prometheus.io/port"] == str(ports["metrics"]["containerPort"])
    for name, port in (("hapticnet-slave", "session"), ("hapticnet-slave-metrics", "metrics")):
        (served,) = OBJECTS["Service", name]["spec"]["ports"]
        assert served["targetPort"] == port
        assert served["protocol"] == ports[port]["protocol"]
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        assert SLAVE[probe]["httpGet"] == {"path": "/health", "port": "metrics"}


def test_everything_selects_the_same_pods():
    labels = SLAVES["template"]["metadata"]["labels"]
    selectors = [each["spec"]["selector"] for each in OBJECTS.values()]
    assert all(selector.get("matchLabels", selector) == labels for selector in selectors)
    assert ("Service", SLAVES["serviceName"]) in OBJECTS


def test_the_slave_reads_its_key_where_it_is_copied_with_the_mode_it_asks_for():
    (copying,) = POD["initContainers"]
    assert copying["command"][:5] == ["install", "-D", "-m", "600", "-t"]
    target = copying["command"][5]
    assert [Path(OPTIONS[name]).parent for name in ("key", "masters")] == [Path(target)] * 2
    for container in (copying, SLAVE):
        mounts = {mount["mountPath"] for mount in container["volumeMounts"]}
        assert str(Path(target).parent) in mounts, "a folder that it makes itself: all may write in that of a volume"
    named = {mount["name"] for container in (copying, SLAVE) for mount in container["volumeMounts"]}
    assert named == {volume["name"] for volume in POD["volumes"]}


@pytest.mark.parametrize("container", [*POD["initContainers"], SLAVE], ids=lambda container: container["name"])
def test_a_container_may_do_little_and_has_its_own_core(container):
    assert container["resources"]["requests"] == container["resources"]["limits"]
    assert container["resources"]["requests"]["cpu"].isdigit()
    assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
    assert container["securityContext"]["readOnlyRootFilesystem"]


def test_masters_have_the_time_of_drain_before_a_slave_is_killed():
    assert POD["terminationGracePeriodSeconds"] >= float(OPTIONS["drain"]) + 10
