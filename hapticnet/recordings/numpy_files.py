"""Arrays in NumPy's own files, with limits that are checked before anything large is unpacked."""

import zipfile
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.errors import FileError

MOST_COLUMNS: Final = 10_000
"""Most columns of a table, in a file of any kind, and most arrays in an archive."""

_FLOAT_BYTES: Final = 8


def check_columns(path: Path, count: int) -> None:
    """Raise FileError if a table has more columns than are read."""
    if count > MOST_COLUMNS:
        raise FileError(f"{path}: {count:,} columns; the limit is {MOST_COLUMNS:,}")


def load_npy(path: Path, file: IO[bytes], max_bytes: int) -> npt.NDArray[Any]:
    """Return the array in a .npy file, after checking the shape that its header claims.

    Raises
    ------
    FileError
        If the array, or the same in float64, takes more than `max_bytes`, or it has too many columns.
    ValueError
        If it is damaged, or holds Python objects.
    """
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    each = max(dtype.itemsize, _FLOAT_BYTES * len(dtype.names or (0,)))
    claimed = int(np.prod(shape, dtype=object)) * each
    if claimed > max_bytes:
        raise FileError(f"{path}: an array of {claimed} bytes; the limit is {max_bytes}")
    if len(shape) > 1:  # the longer side has the samples: an array may be either way round
        check_columns(path, min(shape))
    file.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def load_npz(path: Path, max_bytes: int) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays in a .npz file by their names.

    Raises
    ------
    FileError
        If they, or the same in float64, take more than `max_bytes` together, or there are too many.
    Exception
        Of many kinds, if the file is damaged.
    """
    arrays: dict[str, npt.NDArray[Any]] = {}
    left = max_bytes
    with zipfile.ZipFile(path) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
        check_columns(path, len(members))
        unpacked = sum(member.file_size for member in members)
        if unpacked > max_bytes:
            raise FileError(f"{path}: unpacks to {unpacked} bytes; the limit is {max_bytes}")
        for member in members:
            with archive.open(member) as file:
                array = load_npy(path, file, max_bytes)
            left -= max(array.nbytes, _FLOAT_BYTES * array.size)
            if left < 0:
                raise FileError(f"{path}: unpacks to more than {max_bytes} bytes, which is the limit")
            arrays[member.filename.removesuffix(".npy")] = array
    return arrays
