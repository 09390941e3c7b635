"""Arrays from NumPy and MATLAB files as columns."""

import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import FileError, UnavailableError, visible
from hapticnet.recordings.columns import check_columns

Arrays = Mapping[str, npt.NDArray[Any]]
_MAT_HEADER_BYTES: Final = 128
_MAT_COMPRESSED: Final = 15
_PIECE_BYTES: Final = 2**20
_FLOAT_BYTES: Final = 8


class ArraySource:
    """Arrays as columns of shape (rows,), which `read` returns; a two-dimensional NAME is NAME.0, NAME.1, …."""

    def __init__(
        self, path: Path, names: Sequence[str], read: Callable[[Sequence[str]], Sequence[npt.NDArray[Any]]], rows: int
    ) -> None:
        self.path = path
        check_columns(path, len(names))
        self.names = tuple(visible(name.strip()) for name in names)
        self.notes: tuple[str, ...] = ()
        self._names = tuple(names)
        self._read = read
        self._rows = rows
        if not self.names or not rows:
            raise FileError(f"{path}: there are no samples in the file")

    def numbers(self, indices: Sequence[int]) -> FloatArray:
        """Return columns, shape (rows, columns), with NaN where a value is missing; FileError if one is not numeric."""
        values = np.empty((self._rows, len(indices)))
        for place, column in enumerate(self._columns(indices)):
            name = self.names[indices[place]]
            if column.dtype.kind not in "biuf":
                raise FileError(f'{self.path}, column "{name}": holds {column.dtype}; expected real numbers')
            with np.errstate(over="ignore"):  # of long doubles; reported below
                values[:, place] = column
            infinite = np.flatnonzero(np.isinf(values[:, place]))
            if len(infinite):
                row = int(infinite[0])
                raise FileError(
                    f'{self.path}, {self.place(row)}, column "{name}": {values[row, place]} is not a finite number'
                )
        return values

    def has_stamps(self, index: int) -> bool:
        """Return whether a column holds dates and times."""
        return self._columns([index])[0].dtype.kind == "M"

    def stamps_us(self, index: int) -> IntArray:
        """Return dates and times in µs since 1970, shape (rows,); `times.NO_STAMP` where one is missing."""
        stamps: IntArray = self._columns([index])[0].astype("datetime64[us]").astype(np.int64)
        return stamps

    def place(self, row: int) -> str:
        """Return the place of a row in the file, for a message."""
        return f"row {row}"

    def _columns(self, indices: Sequence[int]) -> list[npt.NDArray[Any]]:
        columns = [np.asarray(column) for column in self._read([self._names[index] for index in indices])]
        for index, column in zip(indices, columns, strict=True):
            if column.shape != (self._rows,):
                raise FileError(
                    f'{self.path}, column "{self.names[index]}": shape {column.shape}; expected ({self._rows},)'
                )
        return columns


def load_npy(path: Path, file: IO[bytes], max_bytes: int) -> npt.NDArray[Any]:
    """Return the array in a .npy file; FileError if its header claims more than `max_bytes`, ValueError if damaged."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    each = max(dtype.itemsize, _FLOAT_BYTES * len(dtype.names or (0,)))
    claimed = int(np.prod(shape, dtype=object)) * each
    if claimed > max_bytes:
        raise FileError(f"{path}: an array of {claimed} bytes; the limit is {max_bytes}")
    if len(shape) > 1:  # the longer side has the samples: an array may have either orientation
        check_columns(path, min(shape))
    file.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def load_npz(path: Path, max_bytes: int) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays in a .npz file by their names; FileError if too large or many, other exceptions if damaged."""
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


def open_npy(path: Path, max_bytes: int) -> ArraySource:
    """Return the array in a .npy file, of shape (n,) or (n, columns) or structured, as columns."""
    with path.open("rb") as file:
        array = load_npy(path, file, max_bytes)
    if array.dtype.names:
        return _source(path, {name: array[name] for name in array.dtype.names}, len(array) if array.ndim else 0)
    if array.ndim not in (1, 2):
        raise FileError(f"{path}: array of shape {array.shape}; expected (n,) or (n, columns)")
    check_columns(path, array.shape[1] if array.ndim > 1 else 1)
    return _source(path, {str(index): column for index, column in enumerate(np.atleast_2d(array.T))}, len(array))


def open_npz(path: Path, max_bytes: int) -> ArraySource:
    """Return the arrays in a .npz file as columns."""
    return _named(path, load_npz(path, max_bytes))


def open_mat(path: Path, max_bytes: int) -> ArraySource:
    """Return the variables in a MATLAB file, up to v7, as columns; fields of a structure as NAME.FIELD."""
    try:
        from scipy import io
    except ImportError as error:
        raise UnavailableError(f"{path}: reading MATLAB files needs SciPy (extra mat): pip install scipy") from error
    elements = sum(int(np.prod(shape, dtype=object)) for _, shape, _ in io.whosmat(path))
    if 8 * elements > max_bytes:  # loading an array with a damaged shape can end the process
        raise FileError(f"{path}: unpacks to {8 * elements} bytes; the limit is {max_bytes}")
    if _unpacked_mat(path, max_bytes) > max_bytes:  # including the fields of structures, which whosmat omits
        raise FileError(f"{path}: unpacks to more than {max_bytes} bytes, which is the limit")
    variables = io.loadmat(path, appendmat=False, simplify_cells=True)
    arrays: dict[str, npt.NDArray[Any]] = {}

    def collect(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for field, inner in value.items():
                collect(f"{name}.{field}" if name else str(field), inner)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biufcM":
            arrays[name] = value

    collect("", {name: value for name, value in variables.items() if not name.startswith("__")})
    return _named(path, arrays)


def _unpacked_mat(path: Path, most: int) -> int:
    """Return how many bytes the variables of a MATLAB file of v5 to v7 unpack to, or a number above `most`."""
    total = 0
    with path.open("rb") as file:
        header = file.read(_MAT_HEADER_BYTES)
        order: Literal["little", "big"] = "little" if header[-2:] == b"IM" else "big"
        while header.startswith(b"MATLAB") and total <= most and len(tag := file.read(8)) == 8:
            kind, size = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if kind != _MAT_COMPRESSED:
                file.seek(size, 1)
                total += size
                continue
            unpacker = zlib.decompressobj()
            packed = file.read(size)
            while packed and total <= most:
                total += len(unpacker.decompress(packed, _PIECE_BYTES))
                packed = unpacker.unconsumed_tail
    return total


def _named(path: Path, arrays: Arrays) -> ArraySource:
    """Return named arrays as columns; if their lengths differ, those as long as the longest vector."""
    squeezed = {name: np.squeeze(array) for name, array in arrays.items()}
    for name, array in list(squeezed.items()):
        if array.dtype.names:
            squeezed |= {f"{name}.{field}": array[field] for field in array.dtype.names}
            del squeezed[name]
    rows = max((len(array) for array in squeezed.values() if array.ndim == 1), default=0)
    rows = rows or max((max(array.shape) for array in squeezed.values() if array.ndim == 2 and array.size), default=0)
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, array in squeezed.items():
        if array.shape == (rows,):
            columns[name] = array
        elif array.ndim == 2 and rows in array.shape:
            samples_first = array if len(array) == rows else array.T
            check_columns(path, len(columns) + samples_first.shape[1])
            columns |= {f"{name}.{index}": column for index, column in enumerate(samples_first.T)}
    return _source(path, columns, rows)


def _source(path: Path, columns: Arrays, rows: int) -> ArraySource:
    return ArraySource(path, list(columns), lambda names: [columns[name] for name in names], rows)
