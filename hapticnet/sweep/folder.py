"""The folder of a study's results: shards that are whole or not there, and what they belong to."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from hapticnet.documents import LARGEST_DOCUMENT
from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.files import PART, check_folder, locked, read_text, replacing, replacing_bytes
from hapticnet.sweep.grid import Shard, overlap
from hapticnet.sweep.runs import Plan, all_columns, runs_of
from hapticnet.sweep.table import digest_of, read_origin, versions

ABOUT: Final = "sweep.json"
STUDY: Final = "study.toml"
LOCK: Final = "sweep.lock"
SHARDS: Final = "shard-*.parquet"
"""The files with the rows, as a glob."""

_SHARD: Final = re.compile(r"shard-(\d{10})-(\d{10})-([0-9a-f]{16})\.parquet")
_POISON: Final = re.compile(r"shard-(\d{10})-(\d{10})\.poison\.json")


class Folder:
    """Results of one study.

    Parameters
    ----------
    path
        The folder; `open` creates it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other sweeps out of the folder.

        Raises
        ------
        FileError
            If the folder cannot be written.
        UnavailableError
            If a sweep is at work in it.
        """
        check_folder(self.path)
        with locked(self.path / LOCK, UnavailableError(f"{self.path}: another sweep is at work in this folder")):
            yield

    def open(self, plan: Plan, text: str, about: Mapping[str, Any]) -> list[Shard]:
        """Prepare the folder for a plan; return the shards that are there.

        Parameters
        ----------
        text
            The study's file, of which the folder keeps a copy.
        about
            What else to note: where and how the sweep was begun.

        Raises
        ------
        SettingsError
            If the folder belongs to another study, or has more runs than the plan.
        FileError
            If a file in it cannot be read or written, or is not whole.
        """
        self._refuse_other(plan)
        for left in self.path.iterdir():
            if left.name.endswith(PART) or _POISON.fullmatch(left.name):
                left.unlink()
        shards = self.shards(plan.digest)
        runs = runs_of(plan)
        last = max((shard.end for shard in shards), default=0) - 1
        if last >= runs:
            raise SettingsError(
                f"{self.path} has run {last:,} already, and this study has {runs:,} runs; fewer repeats need another"
                " folder"
            )
        content = {
            "name": plan.name,
            "study": plan.digest,
            "task": type(plan).__name__.removesuffix("Plan").lower(),
            "seed": plan.seed,
            "cells": plan.cells,
            "repeats": plan.repeats,
            "runs": runs,
            "columns": all_columns(plan),
            "measures": plan.measures,
            "versions": versions(),
            **about,
        }
        with replacing(self.path / STUDY, follow=False) as file:
            file.write(text)
        with replacing(self.path / ABOUT, follow=False) as file:
            file.write(json.dumps(content, indent=1) + "\n")
        return shards

    def about(self) -> dict[str, Any]:
        """Return what the folder belongs to.

        Raises
        ------
        FileError
            If it is not a folder of a study.
        """
        path = self.path / ABOUT
        if not path.exists():
            raise FileError(f"{self.path} has no {ABOUT}: it is not a folder that hapticnet sweep wrote")
        try:
            content: dict[str, Any] = json.loads(read_text(path, LARGEST_DOCUMENT))
            known = {key: content[key] for key in ("name", "study", "runs", "cells", "columns", "measures", "versions")}
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise FileError(f"{path} is damaged: {error}; it was written by hapticnet sweep") from error
        return content | known

    def shards(self, digest: str) -> list[Shard]:
        """Return the shards that are there and whole.

        Raises
        ------
        FileError
            If one is damaged, belongs to another study, or has runs of another one.
        """
        found: dict[Path, Shard] = {}
        for file in sorted(self.path.glob(SHARDS)):
            named = _SHARD.fullmatch(file.name)
            about, rows, digest_found = read_origin(file)
            if named is not None and named[3] != digest_found:
                raise FileError(f"{file} was changed or damaged; remove it, and its runs are computed again")
            shard = Shard(about.first, about.end)
            if about.study != digest:
                raise FileError(f"{file} belongs to another study; move it elsewhere")
            if named is None or shard != Shard(int(named[1]), int(named[2])) or rows != shard.runs:
                raise FileError(f"{file} has {rows} rows from run {shard.first} on, which its name does not say")
            found[file] = shard
        if twice := overlap(list(found.values())):
            one, other = [file for file, shard in found.items() if shard in twice][:2]
            raise FileError(f"{one} and {other.name} have runs in common; remove one of them")
        return list(found.values())

    def write(self, shard: Shard, content: bytes) -> None:
        """Store a shard: all of it, on disk, under its name; or nothing.

        Raises
        ------
        FileError
            If it cannot be written.
        """
        with replacing_bytes(self.path / shard_name(shard, content), follow=False, sync=True) as file:
            file.write(content)

    def mark(self, shard: Shard, reason: str) -> None:
        """Note that a shard could not be computed, and why."""
        with replacing(self.path / f"{_stem(shard)}.poison.json", follow=False) as file:
            file.write(json.dumps({"first": shard.first, "end": shard.end, "reason": reason}) + "\n")

    def _refuse_other(self, plan: Plan) -> None:
        """Raise SettingsError if the folder belongs to another study, or another hapticnet computed it."""
        if not (self.path / ABOUT).exists():
            if any(self.path.glob(SHARDS)):
                raise FileError(f"{self.path} has shards but no {ABOUT}; choose another folder")
            return
        there = self.about()
        if there["study"] != plan.digest:
            raise SettingsError(
                f"{self.path} has the results of another study ({there['name']!r}), or this study was changed since;"
                " choose another folder, or undo the change (more repeats are no change)"
            )
        if there["versions"].get("hapticnet") != versions()["hapticnet"]:
            raise SettingsError(
                f"{self.path} was computed by hapticnet {there['versions'].get('hapticnet')}, and this is"
                f" {versions()['hapticnet']}; choose another folder"
            )


def shard_name(shard: Shard, content: bytes) -> str:
    """Return the file name of a shard: it has a digest of the file, so that no changed bit passes unnoticed."""
    return f"{_stem(shard)}-{digest_of(content)}.parquet"


def _stem(shard: Shard) -> str:
    return f"shard-{shard.first:010d}-{shard.end:010d}"
