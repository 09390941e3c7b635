"""Whether sessions are sealed or open (on loopback or with ``--insecure``), and with which keys."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hapticnet.errors import FileError, SettingsError
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.key_files import default_key, default_masters, is_missing, load_key, load_roster
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, Roster, format_key, parse_key
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import Entropy
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.runtime.scene_port import find_live_source
from hapticnet.scene.sources import SceneSource


class Guests:
    """The masters that a slave with a key admits, each with its scene. Raises as `read_guests`."""

    def __init__(self, file: Path, key_file: Path) -> None:
        self.file = file  # file of the list of masters
        self.key_file = key_file  # the slave's key
        self.own = load_key(key_file)
        self.roster = Roster()
        self._scenes: dict[str, SceneSource] = {}
        self._sources: list[SceneSource] = []
        self.read()

    def read(self) -> None:
        """Read the list again; if it cannot be used, raise FileError or SettingsError and keep the present one."""
        self.roster, self._scenes = read_guests(self.file, self.own.public)
        self._sources += self._scenes.values()

    def scene_of(self, entry: MasterEntry | None) -> SceneSource | None:
        """Return the source of a master's scene; None if the list does not name one."""
        return None if entry is None or entry.scene is None else self._scenes[entry.scene]

    def close(self) -> list[str]:
        """Close the scenes, including those of earlier lists; return the faults."""
        return [fault for source in self._sources for fault in source.close()]


def read_guests(file: Path, own: bytes) -> tuple[Roster, dict[str, SceneSource]]:
    """Return a list of masters and the scenes it names; `own` is the slave's public key.

    Paths are relative to the folder of the list. FileError or SettingsError if it, a scene or a key cannot be used.
    """
    roster = load_roster(file)
    scenes: dict[str, SceneSource] = {}
    for number, entry in enumerate(roster, start=1):
        where = f"{file}: master {number}"
        if entry.public == own:
            raise SettingsError(
                f"{where}: public is the slave's own; use what 'hapticnet key public' prints on the master's host"
            )
        if entry.scene is not None and entry.scene not in scenes:
            try:
                scenes[entry.scene] = find_live_source(entry.scene, file.parent)
            except (FileError, SettingsError) as error:
                raise type(error)(f"{where}: {error}") from error
    return roster, scenes


@dataclass(frozen=True, slots=True)
class SlaveTrust:
    """The masters that a slave serves."""

    guests: Guests | None  # the masters with keys; None if there are no sealed sessions
    serves_open: bool  # whether open sessions are served
    unused_key: Path | None = None  # this host's key, if sessions are open only because the slave listens on loopback

    @property
    def files(self) -> list[Path]:
        """The files that are read."""
        return [] if self.guests is None else [self.guests.key_file, self.guests.file]

    def scene_of(self, entry: MasterEntry | None) -> SceneSource | None:
        """Return the source of a master's scene; None if no list names one."""
        return None if self.guests is None else self.guests.scene_of(entry)

    def doors(self, entropy: Entropy) -> dict[int, Door]:
        """Return the doors for masters, by the version of the wire format."""
        doors: dict[int, Door] = {OPEN: Door()} if self.serves_open else {}
        if self.guests is not None:
            doors[SEALED] = SealedDoor(self.guests.own.private, self.guests.roster, entropy)
        return doors

    def lines(self) -> list[str]:
        """Return notes for the person who starts the slave."""
        lines = []
        if self.guests is not None:
            count = len(self.guests.roster)
            lines.append(
                f"sealed sessions for {count} {'master' if count == 1 else 'masters'} of {self.guests.file};"
                f" they need --peer-key {format_key(self.guests.own.public)}"
            )
            if self.guests.own.psk != NO_PSK:
                lines.append("the psk in this key file is not used: a slave takes it from the [[master]] tables")
        elif self.unused_key is not None:
            lines.append(
                f"open sessions only, as on loopback by default: {self.unused_key} is not used; add --key"
                f" {self.unused_key} for sealed sessions"
            )
        return lines

    def warnings(self, loopback: bool) -> list[str]:
        """Return the risks; `loopback` says whether only this host can reach the slave."""
        if self.serves_open and not loopback:
            return ["open sessions are not encrypted, and anyone who can reach this port is served"]
        return []


def option(name: str) -> str:
    """Return a parameter's name on the command line."""
    return f"--{name.replace('_', '-')}"


def slave_trust(
    address: object, loopback: bool, key: Path | None, masters: Path | None, insecure: bool,
    called: Callable[[str], str] = option,
) -> SlaveTrust:  # fmt: skip
    """Return the masters that a slave serves at `address`; FileError or SettingsError for an unusable key."""
    if key is None and masters is None and (loopback or insecure):
        unused = None if insecure or is_missing(default_key()) else default_key()
        return SlaveTrust(None, serves_open=True, unused_key=unused)
    key_file = key or default_key()
    masters = masters or default_masters(key_file)
    if key is None and is_missing(key_file):
        raise SettingsError(
            f"{address} can be reached from other hosts, so sessions need keys: make this host's with"
            f" 'hapticnet key new' and list the masters in {masters}, or serve anyone with {called('insecure')}"
        )
    return SlaveTrust(Guests(masters, key_file), serves_open=insecure)


def master_key(
    address: object, loopback: bool, key: Path | None, peer_key: str | None, insecure: bool,
    called: Callable[[str], str] = option,
) -> MasterKey | None:  # fmt: skip
    """Return the keys for sessions with the slave at `address`; None for open sessions. Raises like `slave_trust`."""
    if peer_key is None and (loopback or insecure):  # HAPTICNET_KEY may name a key for other slaves
        return None
    if key is None and peer_key is None:
        raise SettingsError(
            f"{address} is another host, so the session needs keys: add {called('peer_key')} with the slave's public"
            f" key, which 'hapticnet key public' prints on the slave's host, or {called('insecure')} for a session that"
            " is not encrypted"
        )
    if insecure:
        given = called("key" if peer_key is None else "peer_key")
        raise SettingsError(
            f"{called('insecure')} asks for an open session, and {given} for a sealed one; omit one of them"
        )
    if peer_key is None:
        raise SettingsError(
            f"{called('key')} needs {called('peer_key')}: the slave's public key, which 'hapticnet key public' prints"
            " on its host"
        )
    peer = parse_key(peer_key, called("peer_key"))
    return MasterKey(load_key(key or default_key()), peer)


def refusal_advice(key: MasterKey | None, code: Code | None) -> str:
    """Return the entry missing in the slave's list, if that is why the slave refused this key."""
    return f'; there, public = "{format_key(key.own.public)}"' if key is not None and code is Code.KEY else ""


def silence_advice(key: MasterKey | None, unreadable: int, hint: str | None = None) -> str:
    """Return advice while no session begins; `unreadable` answers did not open, `hint` is not authenticated."""
    if key is None:
        return "is the slave running there?"
    if hint is not None:
        return f"an unauthenticated answer says: {hint}"
    if unreadable:
        return "its answers cannot be opened: do this key file and the slave's list of masters have the same psk?"
    return "is the slave running there, and is --peer-key what 'hapticnet key public' prints on its host?"
