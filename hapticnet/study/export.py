"""A copy of a study's data as BIDS: columns are renamed; no value changes."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import SettingsError
from hapticnet.files import make_folder, replacing
from hapticnet.study import store
from hapticnet.study.plan import PLAN_FILE, Plan, find_plan
from hapticnet.study.reading import read_people, table_files
from hapticnet.study.rows import MISSING, LimitsRow, OrderRow, Row, answers_about, columns, sidecar, to_line

BIDS_VERSION: Final = "1.10.0"

TASKS: Final[dict[str, type[Row]]] = {"order": OrderRow, "limits": LimitsRow}

TITLES: Final = {
    "order": "Ordering of three virtual tissues by stiffness",
    "limits": "Just-noticeable difference of a force at the fingertip",
}

BIDS_NAMES: Final = {"onset_s": "onset", "duration_s": "duration", "response_time_s": "response_time"}
"""Columns to which BIDS gives another name; the others have the name of the row's attribute."""


def export(source: Path, target: Path, *, name: str, people: str = "") -> list[Path]:
    """Write the data of a study to a new folder; return the files.

    Parameters
    ----------
    source
        The folder of the study.
    target
        A folder that does not exist or is empty.
    name
        Name of the data set.
    people
        Who made it, for "Authors"; several are separated by semicolons.

    Raises
    ------
    SettingsError
        If there is nothing to export, or the target is not empty.
    FileError
        If a file cannot be read or written.
    """
    tables = {task: table_files(source, kind) for task, kind in TASKS.items()}
    tables = {
        task: [file for file in files if target.resolve() not in file.resolve().parents]
        for task, files in tables.items()
    }
    if not any(tables.values()):
        raise SettingsError(f"{source} has no tables of a study")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise SettingsError(f"{target} is not empty; choose a new folder")
    rows: dict[tuple[str, str, int], list[Row]] = {}
    for task, files in tables.items():
        for file in files:
            for row in store.read_rows(file, TASKS[task]):
                rows.setdefault((task, row.participant, row.session), []).append(row)
    observers = sorted({row.observer for own in rows.values() for row in own if row.observer})
    authors = [each.strip() for each in people.split(";") if each.strip()]
    texts = _bids(rows, _describe(name, observers), authors, source)
    written = []
    for path, text in texts.items():
        file = target / path
        make_folder(file.parent)
        with replacing(file) as stream:
            stream.write(text)
        written.append(file)
    return written


def _plan(source: Path) -> Plan | None:
    """Return the plan of a study; None if it is not there, as in a folder that holds only some of its files."""
    path = source / PLAN_FILE
    return find_plan(str(path)) if path.exists() else None


def _describe(name: str, observers: Sequence[str]) -> tuple[str, str]:
    """Return name and description, which say if the data are simulated."""
    if observers:
        told = f"SIMULATED: no person took part; the observer {', '.join(observers)} answered."
        return f"{name} (simulated)", f"{told} Made by hapticnet experiment."
    return name, "Ordering of virtual tissues and JNDs of force at the fingertip, measured by hapticnet experiment."


def _bids(
    rows: Mapping[tuple[str, str, int], Sequence[Row]], told: tuple[str, str], authors: Sequence[str], source: Path
) -> dict[str, str]:
    name, description = told
    version = next((row.version for own in rows.values() for row in own if row.version), None)
    dataset: dict[str, Any] = {
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "hapticnet", **({"Version": version} if version else {})}],
    }
    if authors:
        dataset["Authors"] = list(authors)
    texts = {"dataset_description.json": _json(dataset), "README.md": _readme(name, description)}
    people = sorted({participant for _, participant, _ in rows})
    measured = {each.participant: each for each in read_people(source)}
    plan = _plan(source)
    asked = [] if plan is None else [question.name for question in plan.question]
    lines = ["\t".join(["participant_id", "weber_fraction", "simulated", *asked])]
    for person in people:
        observer = next(
            (row.observer for key, own in rows.items() if key[1] == person for row in own if row.observer), None
        )
        fraction = f"{measured[person].weber_fraction:.6g}" if person in measured else MISSING
        answers = answers_about(row for key, own in rows.items() if key[1] == person for row in own)
        told_of = (answers.get(name, MISSING) for name in asked)
        lines.append("\t".join([f"sub-{person}", fraction, observer or MISSING, *told_of]))
    texts["participants.tsv"] = "\n".join(lines) + "\n"
    texts["participants.json"] = _json(
        {
            "weber_fraction": {"Description": "Measured JND of force as a share of the force."},
            "simulated": {"Description": "Name of the simulated observer; n/a for a person."},
            **{question.name: {"Description": question.text} for question in (plan.question if plan else [])},
        }
    )
    for (task, person, session), own in sorted(rows.items()):
        kind = TASKS[task]
        stem = f"sub-{person}/ses-{session}/beh/sub-{person}_ses-{session}_task-{task}_events"
        attributes = _bids_order(kind)
        old = {attribute: column for column, attribute in columns(kind).items()}
        shown = [BIDS_NAMES.get(attribute, attribute) for attribute in attributes]
        cells = [[row[old[attribute]] for attribute in attributes] for row in map(row_cells, own)]
        texts[f"{stem}.tsv"] = "\n".join("\t".join(line) for line in [shown, *cells]) + "\n"
        described = sidecar(kind, {} if plan is None else plan.texts.levels)
        texts[f"{stem}.json"] = _json(
            {
                "TaskName": task,
                "TaskDescription": TITLES[task],
                "StimulusPresentation": {
                    "SoftwareName": "hapticnet",
                    **({"SoftwareVersion": version} if version else {}),
                },
                **{label: described[old[each]] for each, label in zip(attributes, shown, strict=True)},
            }
        )
    return texts


def row_cells(row: Row) -> dict[str, str]:
    """Return the cells of a row as they stand in its table, by column."""
    return dict(zip(columns(type(row)), to_line(row).rstrip("\n").split("\t"), strict=True))


def _bids_order(kind: type[Row]) -> list[str]:
    """Return the attributes with onset and duration first, as BIDS has them."""
    attributes = list(columns(kind).values())
    first = ["onset_s", "duration_s"]
    return first + [each for each in attributes if each not in first]


def _readme(name: str, description: str) -> str:
    return (
        f"# {name}\n\n{description}\n\n"
        "One row for each event; the column `event` tells its kind, and rows with `trial` are answered trials.\n"
        "Missing values are `n/a`. Participants have numbers; names were never stored.\n"
    )


def _json(value: object) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"
