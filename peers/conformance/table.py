"""The table of peers/README.md: what each peer has, and what agreed when the suite ran.

make conformance runs the suite, and writes results.json and the table; python -m conformance.table js, only for
this peer. With --render, the table is written from results.json.
"""

import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from conformance.child import PEERS, Child, Peer, find_peers
from hapticnet.codec.registry import every_codec

RESULTS: Final = Path(__file__).with_name("results.json")
README: Final = PEERS / "README.md"
BEGIN, END = "<!-- written by conformance/table.py -->", "<!-- end -->"
PYTHON_MASTER: Final = "examples/in_a_loop.py"
PYTHON: Final = PEERS.parent / PYTHON_MASTER


def lines_of(path: Path) -> int:
    """Return how many lines a file has."""
    return len(path.read_text().splitlines())


def measure(peer: Peer, build: Path, agreed: Counter[str]) -> dict[str, Any]:
    """Return what the table says of a peer."""
    child = Child(peer, build)
    features = child.features
    child.end()
    files = [peer.folder / path for path in peer.command(peer.size, build)]
    return {
        "name": peer.name,
        "features": features,
        "agreed": dict(sorted(agreed.items())),
        "size_bytes": sum(path.stat().st_size for path in files) if files else None,
        "size_of": peer.size_of,
    }


def run_suite(peers: list[Peer]) -> dict[str, Counter[str]]:
    """Run the suite; return how much of each kind agreed for each peer. Raise SystemExit if anything did not."""
    chosen = " or ".join(f"[{peer.folder.name}{end}" for peer in peers for end in "-]")
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = ["-m", "pytest", "-n", "2", str(PEERS / "conformance" / "tests"), f"--junitxml={report}"]
        others = ["-o", "junit_family=xunit1", "-k", f"({chosen}) and not test_conformance_table"]
        if subprocess.run([sys.executable, *command, *others], cwd=PEERS.parent, check=False).returncode != 0:
            raise SystemExit("not everything agrees: the table stays as it is")
        agreed: dict[str, Counter[str]] = {peer.folder.name: Counter() for peer in peers}
        for each in ElementTree.parse(report).iter("property"):  # noqa: S314 - written by pytest just now
            if each.get("name") == "agreement":
                name, kind, count = (each.get("value") or "").split(" ")
                agreed[name][kind] += int(count)
    return agreed


def row(title: str, cells: list[str]) -> str:
    """Return a row of the table."""
    return f"| {' | '.join([title, *cells])} |"


def master_cell(folder: str, path: str) -> str:
    """Return the smallest master and its length."""
    return f"[{lines_of(PEERS / folder / path)} lines]({folder}/{path})"


def listed(feature: str) -> str:
    """Return a list of features for people."""
    return ", ".join(feature.split(",")) if feature not in ("", "-") else "–"


def render(results: dict[str, Any]) -> str:
    """Return the table. It has a column for hapticnet itself, against which all others are compared."""
    declared = {peer.folder.name: peer for peer in find_peers()}
    peers = [(folder, result, result["features"]) for folder, result in results.items() if folder in declared]
    codecs = len(every_codec())
    most = {kind: max(each["agreed"].get(kind, 0) for _, each, _ in peers) for kind in ("vectors",)}

    def agreed(kind: str) -> list[str]:
        return [f"{each['agreed'].get(kind, 0):,}" for _, each, _ in peers]

    smallest = [master_cell(folder, declared[folder].smallest_master or "") for folder, _, _ in peers]
    sizes = [
        f"{each['size_bytes'] / 1000:.0f} kB, {each['size_of']}" if each["size_bytes"] else "" for _, each, _ in peers
    ]
    few = [
        listed(",".join(x for x in ("share", "announced", "predicted") if x in f["also"].split(",")))
        for _, _, f in peers
    ]
    few = [each.replace("share", "few positions") for each in few]
    table = [
        row(
            "",
            ["[Python](../docs/refer/api.md)", *(f"[{each['name']}]({folder}/README.md)" for folder, each, _ in peers)],
        ),
        "|---" * (len(peers) + 2) + "|",
        row("roles", ["master, slave", *(listed(f["roles"]) for _, _, f in peers)]),
        row("sealed", ["master, slave", *(listed(f["sealed"]) for _, _, f in peers)]),
        row("codecs that a master asks for", [f"{codecs}", *(str(len(f["codecs"].split(","))) for _, _, f in peers)]),
        row(
            "codecs that a slave grants", [f"{codecs}", *(str(len(f["slave_codecs"].split(","))) for _, _, f in peers)]
        ),
        row("against delay, as a master", ["few positions, announced, predicted", *few]),
        row("components of a position, at most", ["24", *(f["axes"] for _, _, f in peers)]),
        row("golden vectors", ["reference", *(f"{n} of {most['vectors']:,}" for n in agreed("vectors"))]),
        row("ticks of sessions, equal to the bit", ["reference", *agreed("ticks")]),
        row("damaged datagrams, treated alike", ["reference", *agreed("malformed")]),
        row("smallest master", [f"[{lines_of(PYTHON)} lines](../{PYTHON_MASTER})", *smallest]),
        row("size", ["", *sizes]),
    ]
    return "\n".join(table)


def write_table(results: dict[str, Any]) -> None:
    """Put the table into the README."""
    text = README.read_text()
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    README.write_text(f"{before}{BEGIN}\n{render(results)}\n{END}{after}")


def main() -> None:
    """Run the suite if it is not only to be rendered, and write the table."""
    known = [peer for peer in find_peers() if not sys.argv[1:] or peer.folder.name in sys.argv[1:]]
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if "--render" not in sys.argv[1:]:
        agreed = run_suite(known)
        with tempfile.TemporaryDirectory() as folder:
            for peer in known:
                found[peer.folder.name] = measure(peer, peer.built(Path(folder)), agreed[peer.folder.name])
        RESULTS.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n")
    write_table(found)


if __name__ == "__main__":
    main()
