"""Keys of sealed sessions: this host's key, the masters a slave admits, and the slave's public key."""

import os
import shlex
import stat
from pathlib import Path
from typing import Final, NamedTuple

from hapticnet.errors import HapticnetError, SettingsError
from hapticnet.protocol.key_files import is_anothers, load_key, load_roster, open_folder
from hapticnet.protocol.keys import MasterKey, PrivateKey, Roster, check_public, format_key, parse_key
from hapticnet.runtime.doctor.finding import Finding, Step, Topic, Verdict
from hapticnet.scene.sources import find_source

SUBJECT: Final = "keys"

SHOWN_NAMES: Final = 5

NEW: Final = "hapticnet key new"
PRINTS_LINES: Final = Step("On each master's host, make a key; it prints the lines for the slave's list:", NEW)


class KeyFiles(NamedTuple):
    """Where keys are.

    Attributes
    ----------
    key, masters
        The key of this host, and the masters that a slave admits; None if no place is known.
    key_named, masters_named
        Whether somebody named that file, so that it must exist.
    peer
        The slave's public key as it was given; None if it was not.
    """

    key: Path | None = None
    masters: Path | None = None
    key_named: bool = False
    masters_named: bool = False
    peer: str | None = None


def examine_keys(files: KeyFiles) -> list[Finding]:
    """Return the findings about keys. Secrets are read, and never shown."""
    own, finding = _examine_key(files.key, named=files.key_named)
    findings = [finding, _examine_masters(files.masters, named=files.masters_named)]
    if files.peer is not None:
        findings.append(judge_peer(files.peer, own))
    return findings


def _examine_key(path: Path | None, *, named: bool) -> tuple[PrivateKey | None, Finding]:
    def topic(public: str | None = None) -> Topic:
        return Topic(SUBJECT, "key", "This host's key", {"path": _name(path), "public": public})

    if path is None or not (named or os.path.exists(path)):
        value = "none; only sessions within this machine are safe without"
        return None, topic().absent(value, Step("Make one:", NEW))
    try:
        key = load_key(path)
    except (HapticnetError, OSError) as error:
        return None, topic().find(
            Verdict.PROBLEM, str(error), "Slave and master refuse to start with it.", _how_to_mend(path)
        )
    public = format_key(key.public)
    if _replaceable(path.parent):
        folder = shlex.quote(str(path.parent.absolute()))
        return key, topic(public).find(
            Verdict.WARNING,
            f"other accounts can replace {path}",
            "They may write in its folder.",
            Step("Forbid it:", f"chmod go-w {folder}"),
        )
    return key, topic(public).ok(f"{path}, readable by its owner only; public key {public}")


def _examine_masters(path: Path | None, *, named: bool) -> Finding:
    def topic(number: int | None = None) -> Topic:
        return Topic(SUBJECT, "masters", "Masters admitted", {"path": _name(path), "masters": number})

    if path is None or not (named or os.path.exists(path)):
        value = "no list; a slave with a key needs one"
        return topic().absent(value, PRINTS_LINES)
    try:
        roster = load_roster(path)
        _check_scenes(path, roster)
    except (HapticnetError, OSError) as error:
        step = _how_to_mend(path) if os.path.exists(path) else PRINTS_LINES
        return topic().find(Verdict.PROBLEM, str(error), "A slave refuses to start with it.", step)
    if not roster:
        return topic(0).find(Verdict.WARNING, f"{path} lists none", "The slave will serve nobody.", PRINTS_LINES)
    names = [master.name for master in roster]
    shown = ", ".join(names[:SHOWN_NAMES]) + (", …" if len(names) > SHOWN_NAMES else "")
    return topic(len(names)).ok(f"{len(names)} in {path}: {shown}")


def judge_peer(text: str, own: PrivateKey | None) -> Finding:
    """Judge the slave's public key as it was given, beside this host's key if there is one."""
    topic = Topic(SUBJECT, "peer", "The slave's key", {"public": text})
    try:
        public = parse_key(text, "the slave's public key")
        check_public("the slave's public key", public)
        if own is not None:
            MasterKey(own, public)
    except SettingsError as error:
        return topic.find(
            Verdict.PROBLEM,
            str(error),
            "A master refuses to start with it.",
            Step("On the slave's host, print it:", "hapticnet key public"),
        )
    return topic.ok(text)


def _check_scenes(path: Path, roster: Roster) -> None:
    """Raise SettingsError if a master's scene cannot be found."""
    for master in roster:
        if master.scene is not None:
            try:
                find_source(master.scene, path.parent)
            except HapticnetError as error:
                raise SettingsError(f"{path}: scene of master {master.name!r}: {error}") from None


def _how_to_mend(path: Path) -> Step:
    quoted = shlex.quote(str(path.absolute()))
    try:
        mode = path.stat().st_mode
    except OSError:
        return Step("Name the file that exists, or make one:", f"{NEW} {quoted}")
    if not os.access(path, os.R_OK) or is_anothers(path):
        return Step("Give it to the account that runs hapticnet:", f"sudo chown $USER {quoted}")
    if (folder := open_folder(path)) is not None:
        return Step("Let others change nothing in its folder:", f"chmod o-w {shlex.quote(str(folder))}")
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        return Step("Let only its owner use it:", f"chmod 600 {quoted}")
    return Step("Correct the file, or restore it from a copy.")


def _name(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _replaceable(folder: Path) -> bool:
    """Tell whether other accounts may replace files in a folder."""
    try:
        mode = folder.stat().st_mode
    except OSError:
        return False
    return bool(mode & (stat.S_IWGRP | stat.S_IWOTH)) and not mode & stat.S_ISVTX
