"""The store of a study's results: a folder of Parquet shards, each complete (named by digest) or absent."""

import hashlib
import json
import platform
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from hapticnet.documents import LARGEST_DOCUMENT
from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.experiment.provenance import own_version
from hapticnet.files import PART, check_folder, locked, read_bytes, read_text, replacing, replacing_bytes
from hapticnet.sweep.plan import MEASURED, Plan, Runner, rows_of
from hapticnet.sweep.runs import Row, Shard, overlap

ABOUT: Final = "sweep.json"
STUDY: Final = "study.toml"
LOCK: Final = "sweep.lock"
SHARDS: Final = "shard-*.parquet"  # the files with the rows, as a glob
_SHARD: Final = re.compile(r"shard-(\d{10})-(\d{10})-([0-9a-f]{16})\.parquet")
METADATA_KEY: Final = b"hapticnet"
LARGEST_SHARD: Final = 256 * 2**20  # size limit of a shard [B]; the runs of half a minute take less than 1 MB
NEEDS: Final = "hapticnet sweep needs pyarrow and duckdb (extra sweep): pip install pyarrow duckdb"


@cache
def versions() -> dict[str, str]:
    """Return the versions that numbers may depend on."""
    return {"hapticnet": own_version(), "numpy": version("numpy"), "python": platform.python_version()}


def arrow() -> tuple[Any, Any]:
    """Return pyarrow and pyarrow.parquet; an UnavailableError says what to install."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise UnavailableError(NEEDS) from error
    return pa, parquet


def shard_bytes(plan: Plan, shard: Shard, rows: list[Row]) -> bytes:
    """Return rows as a Parquet file with zstd compression, with its provenance."""
    pa, parquet = arrow()
    types = {"int": pa.int64(), "float": pa.float64(), "text": pa.string()}
    origin = {"study": plan.digest, "first": shard.first, "end": shard.end, **versions()}
    schema = pa.schema(
        [(name, types[kind]) for name, kind in plan.columns.items()],
        metadata={METADATA_KEY: json.dumps(origin).encode()},
    )
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.Table.from_pylist(rows, schema=schema), sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


@dataclass(frozen=True, slots=True)
class Computed:
    """A shard that was computed: its Parquet file, its runs with an error, and its duration and processor time [s]."""

    shard: Shard
    content: bytes
    failed: int
    first_error: str | None
    seconds: float
    cpu_s: float


def compute(plan: Plan, runner: Runner, shard: Shard) -> Computed:
    """Return a shard that is ready to be stored."""
    began_s, cpu_s = time.perf_counter(), time.thread_time()
    rows = rows_of(plan, runner, shard)
    content = shard_bytes(plan, shard, rows)
    errors = [str(row["error"]) for row in rows if row["error"] is not None]
    seconds, cpu_s = time.perf_counter() - began_s, time.thread_time() - cpu_s
    return Computed(shard, content, len(errors), errors[0] if errors else None, seconds, cpu_s)


def shard_name(shard: Shard, content: bytes) -> str:
    """Return the file name of a shard."""
    return f"shard-{shard.first:010d}-{shard.end:010d}-{_digest_of(content)}.parquet"


def _digest_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


class Store:
    """The folder with the results of one study; `open` creates it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other sweeps out of the folder; UnavailableError if one is running in it."""
        check_folder(self.path)
        with locked(self.path / LOCK, UnavailableError(f"{self.path}: another sweep is running in this folder")):
            yield

    def open(self, plan: Plan, text: str, about: Mapping[str, Any]) -> list[Shard]:
        """Prepare the folder for a plan, whose file is copied there; return the existing shards.

        SettingsError if the folder belongs to another study or has more runs; FileError if a file cannot be used.
        """
        self._refuse_other(plan)
        for left in self.path.iterdir():
            if left.name.endswith(PART):
                left.unlink()
        shards = self.shards(plan.digest)
        last = max((shard.end for shard in shards), default=0) - 1
        if last >= plan.runs:
            raise SettingsError(
                f"{self.path} has run {last:,} already, and this study has {plan.runs:,} runs; fewer repeats need"
                " another folder"
            )
        content = {
            "name": plan.name,
            "study": plan.digest,
            "seed": plan.seed,
            "cells": plan.cells,
            "repeats": plan.repeats,
            "runs": plan.runs,
            "columns": plan.columns,
            "measures": tuple(MEASURED),
            "versions": versions(),
            **about,
        }
        for name, whole in ((STUDY, text), (ABOUT, json.dumps(content, indent=1) + "\n")):
            with replacing(self.path / name, follow=False) as file:
                file.write(whole)
        return shards

    def about(self) -> dict[str, Any]:
        """Return the folder's description; raise FileError if it is not a folder of a study."""
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
        """Return the existing shards; FileError if one is damaged, of another study, or overlaps another."""
        found: dict[Path, Shard] = {}
        for file in sorted(self.path.glob(SHARDS)):
            named = _SHARD.fullmatch(file.name)
            study, shard, rows, digest_found = _read_shard(file)
            if named is not None and named[3] != digest_found:
                raise FileError(f"{file} was changed or damaged; remove it, and its runs are computed again")
            if study != digest:
                raise FileError(f"{file} belongs to another study; move it elsewhere")
            if named is None or shard != Shard(int(named[1]), int(named[2])) or rows != shard.runs:
                raise FileError(f"{file} has {rows} rows from run {shard.first} on, which does not match its name")
            found[file] = shard
        if twice := overlap(list(found.values())):
            one, other = [file for file, shard in found.items() if shard in twice][:2]
            raise FileError(f"{one} and {other.name} have runs in common; remove one of them")
        return list(found.values())

    def write(self, shard: Shard, content: bytes) -> None:
        """Store a shard atomically, synced to disk, under its name. Raise FileError if it cannot be written."""
        with replacing_bytes(self.path / shard_name(shard, content), follow=False, sync=True) as file:
            file.write(content)

    def _refuse_other(self, plan: Plan) -> None:
        if not (self.path / ABOUT).exists():
            if any(self.path.glob(SHARDS)):
                raise FileError(f"{self.path} has shards but no {ABOUT}; choose another folder")
            return
        there = self.about()
        if there["study"] != plan.digest:
            raise SettingsError(
                f"{self.path} has the results of another study ({there['name']!r}), or this study was changed since;"
                " choose another folder, or undo the change (more repeats are allowed)"
            )
        if there["versions"].get("hapticnet") != versions()["hapticnet"]:
            raise SettingsError(
                f"{self.path} was computed by hapticnet {there['versions'].get('hapticnet')}, and this is"
                f" {versions()['hapticnet']}; choose another folder"
            )


def _read_shard(path: Path) -> tuple[str, Shard, int, str]:
    """Return the study and the runs of a shard, its number of rows, and the digest of the file."""
    pa, parquet = arrow()
    content = read_bytes(path, LARGEST_SHARD)
    try:
        found = parquet.read_metadata(pa.BufferReader(content))
        origin = json.loads(found.metadata[METADATA_KEY])
        shard = Shard(int(origin["first"]), int(origin["end"]))
        return str(origin["study"]), shard, int(found.num_rows), _digest_of(content)
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(
            f"{path} is not a complete shard of a study; remove it, and its runs are computed again"
        ) from error
