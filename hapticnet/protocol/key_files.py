"""Key files and lists of masters, stored as TOML.

docs/understand/security.md shows both; only the owner may read a file with a secret.
"""

import os
import shlex
import stat
from pathlib import Path
from typing import Annotated, Final

import tomli_w
from pydantic import BaseModel, Field

from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import FileError, SettingsError
from hapticnet.protocol.keys import NO_PSK, MasterEntry, PrivateKey, Roster, format_key, parse_key

PRIVATE_MODE: Final = 0o600
PRIVATE_FOLDER_MODE: Final = 0o700

ROOT: Final = 0  # account that can change any file anyway
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_WRITTEN_BY_OTHERS: Final = stat.S_IWGRP | stat.S_IWOTH

# Mistakes in a field with repr=False are reported without its value.
_Secret = Annotated[str, Field(repr=False)]
_OptionalSecret = Annotated[str | None, Field(repr=False)]


class _KeyTable(BaseModel):
    model_config = STRICT

    private: _Secret
    psk: _OptionalSecret = None


class _MasterTable(BaseModel):
    model_config = STRICT

    name: str
    public: str
    psk: _OptionalSecret = None
    scene: str | None = None
    fastest_rate_hz: float | None = None
    most_sessions: int | None = None


class _RosterTable(BaseModel):
    model_config = STRICT

    master: list[_MasterTable] = []


def default_key() -> Path:
    """Return the default path of a host's key."""
    base = os.environ.get("XDG_CONFIG_HOME", "")
    # The XDG base directory specification: relative paths must be ignored.
    folder = Path(base) if Path(base).is_absolute() else Path.home() / ".config"
    return folder / "hapticnet" / "key.toml"


def default_masters(key: Path) -> Path:
    """Return the slave's list of masters that belongs to a key file."""
    return key.parent / "masters.toml"


def load_key(path: Path) -> PrivateKey:
    """Return the key in a file; FileError or SettingsError unless it is valid and private."""
    if is_missing(path):
        raise FileError(f"{path} does not exist; make it with: hapticnet key new {shlex.quote(str(path))}")
    text = read_document(path)
    _check_owner(path)
    _check_private(path)
    table = parse_document(text, str(path), _KeyTable)
    try:
        return PrivateKey(parse_key(table.private, "private", secret=True), _psk(table.psk))
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None


def load_roster(path: Path) -> Roster:
    """Return the masters in a slave's list.

    Raise FileError if the file is missing, unreadable or not TOML; if group or others may write it, it is another
    account's, or all accounts can change its folder; or if it holds a pre-shared key and is accessible to group or
    others. Raise SettingsError if a key is unknown or missing, a value is invalid, or a master is listed twice.
    """
    if is_missing(path):
        raise FileError(
            f"{path} does not exist; it has a [[master]] table for each master, which 'hapticnet key new' prints on the"
            " master's host"
        )
    table = parse_document(read_document(path), str(path), _RosterTable)
    _check_owner(path)
    if any(master.psk is not None for master in table.master):
        _check_private(path)
    elif (mode := _mode(path)) & _WRITTEN_BY_OTHERS:
        raise FileError(
            f"{path} can be changed by other users (mode {mode:04o}); run: chmod go-w {shlex.quote(str(path))}"
        )
    masters = []
    for number, master in enumerate(table.master, start=1):
        try:
            keys = {"public": parse_key(master.public, "public"), "psk": _psk(master.psk)}
            masters.append(MasterEntry(**{**master.model_dump(), **keys}))
        except SettingsError as error:
            raise SettingsError(f"{path}: master {number}: {error}") from None
    try:
        return Roster(masters)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None


def is_missing(path: Path) -> bool:
    """Return whether a file is missing; one that cannot be examined may exist."""
    try:
        path.stat()
    except FileNotFoundError:
        return True
    except (OSError, ValueError):  # reading it gives the reason
        pass
    return False


def write_key(path: Path, key: PrivateKey) -> None:
    """Write a new key file that only its owner can read; FileError if that fails. No existing file is ever changed."""
    content = {"private": format_key(key.private)}
    if key.psk != NO_PSK:
        content["psk"] = format_key(key.psk)
    try:
        path.parent.mkdir(mode=PRIVATE_FOLDER_MODE, parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise FileError(f"{path.parent}: cannot create the folder: {_reason(error)}") from None
    try:
        # O_EXCL neither follows a link nor opens what exists, and the mode holds from the first byte.
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_MODE)
    except FileExistsError:
        raise FileError(f"{path} exists, and a key is never overwritten; name another file or move it away") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {_reason(error)}") from None
    try:
        with open(descriptor, "wb") as file:
            file.write(tomli_w.dumps(content).encode())
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        path.unlink(missing_ok=True)
        raise FileError(f"{path}: cannot be written: {_reason(error)}") from None


def dump_master(entry: MasterEntry) -> str:
    """Return a master's table for the slave's list, without its pre-shared key."""
    table: dict[str, str | float] = {"name": entry.name, "public": format_key(entry.public)}
    for key in ("scene", "fastest_rate_hz", "most_sessions"):
        value = getattr(entry, key)
        if value is not None:
            table[key] = value
    return f"[[master]]\n{tomli_w.dumps(table)}"


def _psk(text: str | None) -> bytes:
    if text is None:
        return NO_PSK
    psk = parse_key(text, "psk", secret=True)
    if psk == NO_PSK:
        raise SettingsError("psk is all zeros, which is not a secret; omit it or use 32 random bytes")
    return psk


def open_folder(path: Path) -> Path | None:
    """Return the folder of a file, or of a link's target, if all accounts can replace files in it; else None."""
    for folder in (path.absolute().parent, path.resolve().parent):
        mode = _mode(folder)
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return folder
    return None


def is_anothers(path: Path) -> bool:
    """Return whether a file belongs neither to this account nor to root."""
    return _status(path).st_uid not in (ROOT, os.geteuid())


def _check_owner(path: Path) -> None:
    """Raise FileError if another account can change or replace a file because of its owner or its folder."""
    if is_anothers(path):
        raise FileError(
            f"{path} belongs to another account (number {_status(path).st_uid}), which can change it;"
            f" run: sudo chown $USER {shlex.quote(str(path))}"
        )
    folder = open_folder(path)
    if folder is not None:
        raise FileError(
            f"{path} can be replaced by all accounts, because they can change its folder;"
            f" run: chmod o-w {shlex.quote(str(folder))}"
        )


def _check_private(path: Path) -> None:
    """Raise FileError if group or others can read or write a file that holds a secret."""
    mode = _mode(path)
    if mode & _OTHERS:
        raise FileError(
            f"{path} holds a secret and is accessible to other users (mode {mode:04o});"
            f" run: chmod 600 {shlex.quote(str(path))}"
        )


def _mode(path: Path) -> int:
    return stat.S_IMODE(_status(path).st_mode)


def _status(path: Path) -> os.stat_result:
    try:
        return path.stat()
    except OSError as error:
        raise FileError(f"{path}: {_reason(error)}") from error


def _reason(error: OSError | ValueError) -> str:
    return str(getattr(error, "strerror", None) or error)
