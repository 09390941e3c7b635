"""Write docs/benchmarks, its figures and README's headline from the results.

People write the sentences, in the Jinja templates ``*.md.in`` beside this file; the results fill in the figures. A
sentence that interprets a figure is in ``{% claim CONDITION %} … {% endclaim %}``. If a condition does not hold,
or a placeholder has no figure, nothing is written and the exit code is 1.
"""

import argparse
import json
import math
import operator
import sys
import tomllib
import traceback
from collections import Counter
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Any, Final

import plots
from fingerprint import fingerprint
from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError, nodes
from jinja2.exceptions import TemplateRuntimeError
from jinja2.ext import Extension
from jinja2.parser import Parser
from plan import BENCHMARKS

HERE: Final = Path(__file__).parent
REPOSITORY: Final = HERE.parents[1]
PAGES: Final = REPOSITORY / "docs" / "benchmarks"
RELATIONS: Final = {"<=": ("≤ ", operator.le), ">=": ("≥ ", operator.ge)}
ERRORS: Final = (TemplateError, TypeError, ValueError, LookupError, ArithmeticError)
"""Errors that a mistake in a template or target raises."""

PUBLISHED: Final = "published.json"

HEADLINE: Final = ("<!-- headline: written by make bench -->", "<!-- end of headline -->")
"""The lines of README.md between which headline.md.in is inserted."""

APART: Final = {"peers.md": "peers"}
"""Pages of one record that needs root or more packages; they are written only if that record exists."""

MOST_CORES_OF_OTHERS: Final = 0.15
"""Cores that other programs may have used while a published benchmark measured time."""

Row = dict[str, Any]


class Claims(Extension):
    """The tag ``claim``: keeps its sentence, and notes in `environment.failed_claims` if the condition is false."""

    tags = frozenset({"claim"})

    def parse(self, parser: Parser) -> nodes.Node:
        line = next(parser.stream).lineno
        condition = parser.parse_expression()
        compared = list(condition.find_all(nodes.Compare))
        if isinstance(condition, nodes.Compare):
            compared.insert(0, condition)
        sentence = parser.parse_statements(("name:endclaim",), drop_needle=True)
        seen = nodes.List([each.expr for each in compared])
        call = self.call_method("_check", [condition, seen, nodes.Const(parser.filename), nodes.Const(line)])
        return nodes.CallBlock(call, [], [], sentence).set_lineno(line)

    def _check(self, holds: object, seen: Sequence[object], file: str, line: int, caller: Any) -> str:
        sentence: str = caller()
        if not holds:
            source = Path(file).read_text(encoding="utf-8").splitlines()[line - 1]
            claim = source.partition("{% claim ")[2].partition(" %}")[0]
            values = ", ".join(f"{each:.6g}" if isinstance(each, float) else str(each) for each in seen)
            self.environment.failed_claims.append(  # type: ignore[attr-defined]
                f"{Path(file).name}:{line}: the claim {claim!r} does not hold (seen: {values or holds}):"
                f" {' '.join(sentence.split())}"
            )
        return sentence


def where(rows: Sequence[Row], **conditions: object) -> list[Row]:
    """Return the rows with these values; a list means any of its values."""
    found = list(rows)
    for key, value in conditions.items():
        if any(key not in row for row in found):
            raise TemplateRuntimeError(f"the row has no {key!r}")
        found = [row for row in found if (row[key] in value if isinstance(value, list) else row[key] == value)]
    return found


def one(rows: Sequence[Row], **conditions: object) -> Row:
    """Return the only row with these values."""
    found = where(rows, **conditions)
    if len(found) != 1:
        raise TemplateRuntimeError(f"{len(found)} rows instead of 1 with {conditions}")
    return found[0]


def largest(rows: Sequence[Row], key: str) -> Row:
    """Return the row with the largest value of a (dotted) key; None, for never reached, is the largest."""

    def value(row: Row) -> Any:
        found: Any = reduce(operator.getitem, key.split("."), row)
        return math.inf if found is None else found

    return max(rows, key=value)


def ratios(rows: Sequence[Row], over: str, under: str) -> list[Row]:
    """Return the rows that have both figures, not zero, with their ``ratio``."""
    return [row | {"ratio": row[over] / row[under]} for row in rows if row[over] and row[under]]


def fixed(value: float | None, digits: int = 0, factor: float = 1.0) -> str:
    """Return a number with this many decimals, or a dash for None."""
    return "–" if value is None else f"{factor * value:,.{digits}f}"


def percent(value: float | None, digits: int = 0) -> str:
    """Return a share in per cent, or a dash for None."""
    return "–" if value is None else f"{value:.{digits}%}"


def span(values: Sequence[float], digits: int = 0, factor: float = 1.0) -> str:
    """Return the smallest and the largest value, or one if they print alike."""
    return " to ".join(dict.fromkeys(fixed(value, digits, factor) for value in (min(values), max(values))))


def listed(items: Sequence[str]) -> str:
    """Return items as a list in a sentence."""
    items = list(items)
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]])) or "none"


def environment(folder: Path) -> Environment:
    """Return the environment of the templates in `folder`."""
    made = Environment(  # noqa: S701 - Markdown is not escaped
        loader=FileSystemLoader(folder),
        extensions=[Claims],
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {each.__name__: each for each in (where, one, largest, ratios, span, listed)}
    made.filters |= {
        "f": fixed,
        "g": "{:g}".format,
        "pct": percent,
        "counts": lambda items: Counter(items).most_common(),
    }
    made.failed_claims = []  # type: ignore[attr-defined]
    return made


def targets(templates: Environment, folder: Path, context: Row) -> list[Row]:
    """Return every target of targets.toml with its limit, the value measured, and whether that reaches the limit."""
    found = []
    for target in tomllib.loads((folder / "targets.toml").read_text(encoding="utf-8"))["target"]:

        def expression(source: str, row: object = None) -> Any:
            value = templates.compile_expression(source, undefined_to_none=False)(**context, row=row)
            return str(value) if isinstance(value, StrictUndefined) else value  # str() raises

        def evaluate(key: str, row: object = None, target: Row = target) -> Any:
            return expression(target.get(key, "none"), row)

        try:
            for row in evaluate("each") or [evaluate("row")]:
                value, limit = evaluate("value", row), expression(target["limit"][2:], row)
                sign, compare = RELATIONS[target["limit"][:2]]
                found.append(
                    {
                        "what": templates.from_string(target["what"]).render(**context, row=row),
                        "limit": sign + target["show"].format(limit),
                        "measured": "never" if value is None else target["show"].format(value),
                        "at": evaluate("at", row) or "",
                        "reached": value is not None and compare(value, limit),
                    }
                )
        except ERRORS as error:
            raise TemplateRuntimeError(f"targets.toml, {target.get('what')!r}: {error}") from None
    return found


def render(folder: Path, records: dict[str, Row], only: str | None = None) -> tuple[dict[str, str], list[str]]:
    """Return the text of each page by its name, or of one page alone, and the false claims.

    Alone, a page has no targets.

    Raises
    ------
    jinja2.TemplateError
        When a template or a target asks for a figure that the records do not have.
    """
    templates = environment(folder)
    templates.globals["doors"] = None  # a section that is left out without its record
    context = {name: record["results"] for name, record in records.items()} | {"records": records}
    names = sorted(path.name.removesuffix(".in") for path in folder.glob("*.md.in"))
    if only is not None:
        names = [only]
    else:
        context["targets"] = targets(templates, folder, context)
        names = [name for name in names if APART.get(name) in (None, *records)]
    pages = {name: templates.get_template(f"{name}.in").render(**context) for name in names}
    return pages, templates.failed_claims  # type: ignore[attr-defined]


def reasons_against(records: dict[str, Row]) -> list[str]:
    """Return why these records should not be published: several revisions, uncommitted changes, or a busy machine."""
    reasons = []
    revisions = sorted({record.get("revision", "unknown") for record in records.values()})
    if len(revisions) > 1 or any(each.endswith("-dirty") for each in revisions):
        reasons.append(f"the results are of {', '.join(revisions)}; all should be of one commit without changes")
    for each in BENCHMARKS:
        others = records.get(each.name, {}).get("cores_of_others", 0.0)
        if each.timed and others > MOST_CORES_OF_OTHERS:
            reasons.append(f"{each.name}: other programs used {others:.2f} cores (at most {MOST_CORES_OF_OTHERS})")
    return reasons


def published(records: dict[str, Row], quick: Path) -> str:
    """Return the reference of a later test: the revision, and fingerprints of its quick runs."""
    prints = {
        each.name: fingerprint(json.loads(file.read_text(encoding="utf-8"))["results"])
        for each in BENCHMARKS
        if not each.timed and (file := quick / f"{each.name}.json").exists()
    }
    revision = next(iter(records.values())).get("revision", "unknown")
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(print_)}" for name, print_ in prints.items())
    return f'{{"revision": {json.dumps(revision)}, "quick": {{\n{lines}\n}}}}\n'


def main() -> int:
    """Read the results, check the claims, and write figures and pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("results", type=Path, nargs="?", default=REPOSITORY / "results" / "bench", help="folder")
    parser.add_argument("--out", type=Path, default=PAGES, metavar="DIR", help="folder of the pages")
    parser.add_argument("--templates", type=Path, default=HERE, metavar="DIR", help="folder of *.md.in, targets.toml")
    parser.add_argument("--only", metavar="PAGE", help="write this page alone, such as peers.md")
    parser.add_argument("--check", action="store_true", help="check the claims and write nothing")
    parser.add_argument("--draft", action="store_true", help="accept several revisions and a busy machine")
    arguments = parser.parse_args()
    records = {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(arguments.results.glob("*.json"))}
    refused = [] if arguments.draft else reasons_against(records)
    if refused:
        print(*(f"error: {each}" for each in refused), sep="\n", file=sys.stderr)
        return 1
    try:
        pages, failed = render(arguments.templates, records, arguments.only)
    except TemplateError as error:
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.endswith(".in")]
        line = getattr(error, "lineno", None)
        place = (
            f"{Path(frames[-1].filename).name}:{frames[-1].lineno}: " if frames else f"line {line}: " if line else ""
        )
        print(f"error: {place}{error.message}; run `make bench` for every result", file=sys.stderr)
        return 1
    print(*failed, sep="\n", end="\n" if failed else "", file=sys.stderr)
    if failed or arguments.check:
        return int(bool(failed))
    if arguments.only is None:
        plots.draw(records, arguments.out / "figures")
    headline = pages.pop("headline.md", None)
    readme = arguments.out.parents[1] / "README.md"
    if headline is not None and readme.is_file():
        before, start, rest = readme.read_text(encoding="utf-8").partition(HEADLINE[0])
        _, end, after = rest.partition(HEADLINE[1])
        readme.write_text(f"{before}{start}\n{headline}{end}{after}", encoding="utf-8")
    if arguments.only is None:
        (arguments.out / PUBLISHED).write_text(published(records, arguments.results / "quick"), encoding="utf-8")
    for name, text in pages.items():
        (arguments.out / name).write_text(text, encoding="utf-8")
        print(f"wrote {arguments.out / name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
