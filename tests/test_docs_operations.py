"""What docs/use/service.md and the Grafana dashboard say is so."""

import json
import re
from pathlib import Path

from hapticnet.cli import INTERNAL, INTERRUPTED, READER_GONE
from hapticnet.errors import FileError, RefusedError, SettingsError, UnavailableError
from hapticnet.runtime.metrics import TABLES

DOCS = Path(__file__).parents[1] / "docs"
METRICS = {metric.name: metric.kind for table in TABLES.values() for metric in table}
SUFFIXES = {"counter": ("_total",), "gauge": ("",), "histogram": ("_bucket", "_count", "_sum")}
NAMES = {f"hapticnet_{name}{suffix}" for name, kind in METRICS.items() for suffix in SUFFIXES[kind]}


def test_the_dashboard_shows_metrics_that_exist():
    dashboard = json.loads((DOCS / "grafana.json").read_text())
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    used = set(re.findall(r"hapticnet_\w+", " ".join(expressions)))
    assert used <= NAMES
    shown = {name for name in METRICS if any(f"hapticnet_{name}" in each for each in used)}
    assert len(shown) >= 0.7 * len(METRICS)
    places = [tuple(panel["gridPos"].values()) for panel in dashboard["panels"]]
    assert len(set(places)) == len(places)
    assert all(x + width <= 24 for x, _, width, _ in places)


def test_the_page_lists_every_metric_and_no_other():
    text = (DOCS / "use" / "service.md").read_text()
    section = text.partition("## Metrics")[2].partition("\n## ")[0]
    listed = set(re.findall(r"`(hapticnet_\w+)`", section))
    assert listed == {f"hapticnet_{name}{'_total' * (kind == 'counter')}" for name, kind in METRICS.items()} | {
        "hapticnet_info"
    }


def test_the_page_lists_the_exit_codes():
    text = (DOCS / "use" / "service.md").read_text()
    listed = {int(code) for code in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)}
    kinds = {error.exit_code for error in (SettingsError, FileError, UnavailableError, RefusedError)}
    assert listed == {0, 1, *kinds, INTERNAL, INTERRUPTED, READER_GONE, 143}
