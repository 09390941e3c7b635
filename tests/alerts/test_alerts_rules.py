"""The alerts name metrics and events that exist, and each fires in a test."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import get_args

import pytest
import yaml

from hapticnet.node import events
from hapticnet.runtime.metrics import TABLES

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docker" / "prometheus"
RULES = [rule for group in yaml.safe_load((FOLDER / "alerts.yaml").read_text())["groups"] for rule in group["rules"]]
SUFFIXES = {"counter": ("_total",), "gauge": ("",), "histogram": ("_bucket", "_sum", "_count")}
METRICS = {
    f"hapticnet_{metric.name}{suffix}": metric
    for table in TABLES.values()
    for metric in table
    for suffix in SUFFIXES[metric.kind]
}
EVENTS = {event.__name__ for union in (events.SlaveEvent, events.NodeEvent) for event in get_args(union)}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_an_alert_names_metrics_labels_and_events_that_exist(rule):
    named = re.findall(r"\b(hapticnet_\w+)(?:\{([^}]*)\})?", rule["expr"])
    assert {name for name, _ in named} <= set(METRICS)
    for name, matchers in named:
        labels = dict(re.findall(r'(\w+)=~?"([^"]*)"', matchers))
        assert set(labels) <= {METRICS[name].label, "job", "instance"}
        assert labels.get("direction", "sent") in ("sent", "received")
        assert labels.get("event", min(EVENTS)) in EVENTS
    others = set(re.findall(r"\b(process_\w+|up)\b", rule["expr"]))
    assert others <= {"process_cpu_seconds_total", "up"}
    assert named or others


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_an_alert_says_what_it_means_and_how_urgent_it_is(rule):
    assert set(rule["annotations"]) == {"summary", "description"}
    assert rule["labels"]["severity"] in ("page", "ticket")


def test_every_alert_fires_in_a_test():
    tests = yaml.safe_load((FOLDER / "alerts.test.yaml").read_text())["tests"]
    fired = {case["alertname"] for test in tests for case in test["alert_rule_test"] if case["exp_alerts"]}
    assert fired == {rule["alert"] for rule in RULES}


@pytest.mark.parametrize(("verb", "file"), [("check", "alerts.yaml"), ("test", "alerts.test.yaml")])
def test_promtool_accepts_the_rules_and_their_tests(tool_is_missing, verb, file):
    promtool = shutil.which("promtool") or shutil.which(ROOT / "build" / "promtool")
    if promtool is None:
        tool_is_missing("promtool is not installed: make promtool")
    done = subprocess.run([promtool, verb, "rules", FOLDER / file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
