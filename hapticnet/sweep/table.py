"""Rows as Parquet: one file for each shard, which says in its metadata what it belongs to."""

import hashlib
import json
import platform
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import FileError, UnavailableError
from hapticnet.files import read_bytes
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.link import Columns, Row

METADATA_KEY: Final = b"hapticnet"
LARGEST_SHARD: Final = 256 * 2**20
"""Size limit of a shard [B]; the runs of half a minute take less than 1 MB."""

NEEDS: Final = "hapticnet sweep needs pyarrow and duckdb (extra sweep): pip install pyarrow duckdb"


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """What a shard belongs to, and what computed it.

    Attributes
    ----------
    study
        Digest of the study.
    first, end
        Its runs, from the first to before the end.
    hapticnet, numpy, python
        Versions.
    """

    study: str
    first: int
    end: int
    hapticnet: str
    numpy: str
    python: str


def origin(digest: str, shard: Shard) -> Origin:
    """Return the origin of a shard that is computed in this process."""
    return Origin(study=digest, first=shard.first, end=shard.end, **versions())


@cache
def versions() -> dict[str, str]:
    """Return what numbers may depend on besides the study."""
    try:
        own = version("hapticnet")
    except PackageNotFoundError:
        own = "not installed"
    return {"hapticnet": own, "numpy": version("numpy"), "python": platform.python_version()}


def arrow() -> tuple[Any, Any]:
    """Return pyarrow and pyarrow.parquet; an UnavailableError says what to install."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise UnavailableError(NEEDS) from error
    return pa, parquet


def shard_bytes(columns: Columns, rows: list[Row], about: Origin) -> bytes:
    """Return rows as a Parquet file with zstd compression."""
    pa, parquet = arrow()
    types = {"int": pa.int64(), "float": pa.float64(), "text": pa.string()}
    schema = pa.schema(
        [(name, types[kind]) for name, kind in columns.items()],
        metadata={METADATA_KEY: json.dumps(asdict(about)).encode()},
    )
    table = pa.Table.from_pylist(rows, schema=schema)
    sink = pa.BufferOutputStream()
    parquet.write_table(table, sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


def digest_of(content: bytes) -> str:
    """Return the digest of a shard, 16 hexadecimal digits of SHA-256."""
    return hashlib.sha256(content).hexdigest()[:16]


def read_origin(path: Path) -> tuple[Origin, int, str]:
    """Return the origin of a shard, its number of rows, and the digest of the file.

    Raises
    ------
    FileError
        If it is not a whole shard.
    """
    pa, parquet = arrow()
    content = read_bytes(path, LARGEST_SHARD)
    try:
        about = parquet.read_metadata(pa.BufferReader(content))
        return Origin(**json.loads(about.metadata[METADATA_KEY])), int(about.num_rows), digest_of(content)
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise _not_whole(path) from error


def _not_whole(path: Path) -> FileError:
    return FileError(f"{path} is not a whole shard of a study; remove it, and its runs are computed again")
