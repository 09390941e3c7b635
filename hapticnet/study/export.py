"""A copy of a study's data as BIDS: columns are renamed; no value changes."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import SettingsError
from hapticnet.files import make_folder, replacing
from hapticnet.study.plan import PLAN_FILE, find_plan
from hapticnet.study.rows import MISSING, LimitsRow, OrderRow, Row, answers_about, columns, sidecar, to_line
from hapticnet.study.store import read_people, read_table, table_files

BIDS_VERSION: Final = "1.10.0"
TASKS: Final[dict[str, tuple[type[Row], str]]] = {
    "order": (OrderRow, "Ordering of three virtual tissues by stiffness"),
    "limits": (LimitsRow, "Just-noticeable difference of a force at the fingertip"),
}
# Columns with another name in BIDS; the others keep the name of the row's attribute.
BIDS_NAMES: Final = {"onset_s": "onset", "duration_s": "duration", "response_time_s": "response_time"}


def export(source: Path, target: Path, *, name: str, people: str = "") -> list[Path]:
    """Write the data of a study to a new folder, or an empty one; return the files.

    `name` and `people` (separated by semicolons) are for "Name" and "Authors" of the data set. Raises SettingsError if
    there is nothing to export or the target is not empty, and FileError if a file cannot be read or written.
    """
    rows: dict[tuple[str, str, int], list[Row]] = {}  # by participant, task and session
    for task, (kind, _) in TASKS.items():
        for file in table_files(source, kind):
            if target.resolve() not in file.resolve().parents:
                for row in read_table(file, kind):
                    rows.setdefault((row.participant, task, row.session), []).append(row)
    if not rows:
        raise SettingsError(f"{source} has no tables of a study")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise SettingsError(f"{target} is not empty; choose a new folder")
    authors = [each.strip() for each in people.split(";") if each.strip()]
    written = []
    for path, text in _bids(rows, name, authors, source).items():
        file = target / path
        make_folder(file.parent)
        with replacing(file) as stream:
            stream.write(text)
        written.append(file)
    return written


def _bids(
    rows: Mapping[tuple[str, str, int], Sequence[Row]], name: str, authors: Sequence[str], source: Path
) -> dict[str, str]:
    every = [row for own in rows.values() for row in own]
    description = "Ordering of virtual tissues and JNDs of force at the fingertip, measured by hapticnet experiment."
    observers = sorted({row.observer for row in every if row.observer})
    if observers:
        told = f"SIMULATED: no person took part; the observer {', '.join(observers)} answered."
        name, description = f"{name} (simulated)", f"{told} Made by hapticnet experiment."
    version = next((row.version for row in every if row.version), None)
    path = source / PLAN_FILE  # which is missing in a folder with only some files of a study
    plan = find_plan(str(path)) if path.exists() else None
    dataset: dict[str, Any] = {
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "hapticnet", **({"Version": version} if version else {})}],
        **({"Authors": list(authors)} if authors else {}),
    }
    readme = (
        f"# {name}\n\n{description}\n\n"
        "One row for each event; the column `event` has its kind, and rows with `trial` are answered trials.\n"
        "Missing values are `n/a`. Participants have numbers; names were never stored.\n"
    )
    questions = [] if plan is None else plan.question
    about = {
        "weber_fraction": "Measured JND of force as a share of the force.",
        "simulated": "Name of the simulated observer; n/a for a person.",
        **{question.name: question.text for question in questions},
    }
    measured = {each.participant: f"{each.weber_fraction:.6g}" for each in read_people(source)}
    lines = ["\t".join(["participant_id", *about])]
    for person in sorted({row.participant for row in every}):
        own = [row for row in every if row.participant == person]
        observer = next((row.observer for row in own if row.observer), MISSING)
        answers = answers_about(own)
        told_of = (answers.get(question.name, MISSING) for question in questions)
        lines.append("\t".join([f"sub-{person}", measured.get(person, MISSING), observer, *told_of]))
    texts = {
        "dataset_description.json": _json(dataset),
        "README.md": readme,
        "participants.tsv": "\n".join(lines) + "\n",
        "participants.json": _json({key: {"Description": text} for key, text in about.items()}),
    }
    software = {"SoftwareName": "hapticnet", **({"SoftwareVersion": version} if version else {})}
    for (person, task, session), table in sorted(rows.items()):
        kind, title = TASKS[task]
        stem = f"sub-{person}/ses-{session}/beh/sub-{person}_ses-{session}_task-{task}_events"
        names = {attribute: column for column, attribute in columns(kind).items()}
        first = ["onset_s", "duration_s"]  # as in BIDS
        attributes = first + [each for each in names if each not in first]
        shown = [BIDS_NAMES.get(attribute, attribute) for attribute in attributes]
        cells = [dict(zip(names, to_line(row).rstrip("\n").split("\t"), strict=True)) for row in table]
        body = [shown, *([row[attribute] for attribute in attributes] for row in cells)]
        texts[f"{stem}.tsv"] = "".join("\t".join(line) + "\n" for line in body)
        described = sidecar(kind, {} if plan is None else plan.texts.levels)
        heading = {"TaskName": task, "TaskDescription": title, "StimulusPresentation": software}
        columns_told = {label: described[names[each]] for each, label in zip(attributes, shown, strict=True)}
        texts[f"{stem}.json"] = _json(heading | columns_told)
    return texts


def _json(value: object) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"
