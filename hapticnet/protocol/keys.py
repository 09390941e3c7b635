"""Keys of sealed sessions: a host's own key, its peer's public key, and the masters that a slave admits.

A key is 32 bytes, written as 44 characters of base64 (RFC 4648 §4): the format of ``wg genkey``. Private and public
keys are X25519 keys (RFC 7748); a pre-shared key (psk) is any 32 bytes that both ends know.
"""

import base64
import binascii
import reprlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Final

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from hapticnet.checks import check_integer
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.protocol.messages import NAME_BYTES, RATE_HZ
from hapticnet.protocol.settings import Entropy

KEY_BYTES: Final = 32
KEY_CHARACTERS: Final = 44

NO_PSK: Final = bytes(KEY_BYTES)  # stands for no pre-shared key, as in WireGuard
MOST_SESSIONS: Final = 100_000


@dataclass(frozen=True, slots=True)
class PrivateKey:
    """The key of one host, checked; UnavailableError without the algorithms. Its repr shows no secret."""

    private: bytes = field(repr=False)  # X25519 private key, 32 bytes
    psk: bytes = field(default=NO_PSK, repr=False)  # shared by a master and its slave, 32 bytes
    public: bytes = field(init=False)  # public key of `private`, 32 bytes

    def __post_init__(self) -> None:
        _check_length("private", self.private)
        _check_length("psk", self.psk)
        check_algorithms()
        public = X25519PrivateKey.from_private_bytes(self.private).public_key().public_bytes_raw()
        object.__setattr__(self, "public", public)


@dataclass(frozen=True, slots=True)
class MasterKey:
    """A master's keys for a sealed session; SettingsError if `peer` is not a public key, or the master's own."""

    own: PrivateKey
    peer: bytes

    def __post_init__(self) -> None:
        check_public("the slave's public key", self.peer)
        if self.peer == self.own.public:
            raise SettingsError(
                "the slave's public key is the master's own; each host has its own key, and the slave's is printed by"
                " 'hapticnet key public' on the slave's host"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterEntry:
    """One master that a slave admits, and its limits. Raise SettingsError if a value is invalid."""

    name: str  # its name on the slave's console and in the report; at most 64 bytes
    public: bytes  # the master's public key, 32 bytes
    psk: bytes = field(default=NO_PSK, repr=False)  # pre-shared key, 32 bytes; `NO_PSK` if there is none
    scene: str | None = None  # scene this master touches, as `scene.sources.find_source` reads it; None for the slave's
    fastest_rate_hz: float | None = None  # highest sample rate granted to this master [Hz]; None for the slave's
    most_sessions: int | None = None  # most sessions of this master at once; None for the slave's

    def __post_init__(self) -> None:
        check_name(self.name)
        check_public("public", self.public)
        _check_length("psk", self.psk)
        if self.scene == "":
            raise SettingsError("scene is empty; omit it to give this master the slave's scene")
        if self.fastest_rate_hz is not None:
            RATE_HZ._replace(name="fastest_rate_hz").check(self.fastest_rate_hz)
        if self.most_sessions is not None:
            check_integer("most_sessions", self.most_sessions, 1, MOST_SESSIONS)


class Roster:
    """The masters that a slave admits, by public key; SettingsError if two have the same public key or name."""

    def __init__(self, masters: Iterable[MasterEntry] = ()) -> None:
        self._by_public: dict[bytes, MasterEntry] = {}
        names: set[str] = set()
        for number, master in enumerate(masters, start=1):
            other = self._by_public.get(master.public)
            if other is not None:
                raise SettingsError(
                    f"master {number}: public is that of {other.name!r} too; each master has its own key"
                )
            if master.name in names:
                raise SettingsError(f"master {number}: name {master.name!r} is taken; each master has its own name")
            self._by_public[master.public] = master
            names.add(master.name)

    def find(self, public: bytes) -> MasterEntry | None:
        """Return the master with this public key; None if it is not admitted."""
        return self._by_public.get(public)

    def __iter__(self) -> Iterator[MasterEntry]:
        return iter(self._by_public.values())

    def __len__(self) -> int:
        return len(self._by_public)


def new_key(rng: Entropy) -> PrivateKey:
    """Return a new private key drawn from `rng`, without a pre-shared key."""
    return PrivateKey(bytes(int(rng.integers(0, 256)) for _ in range(KEY_BYTES)))


def format_key(key: bytes) -> str:
    """Return a key as 44 characters of base64."""
    return base64.b64encode(key).decode("ascii")


def parse_key(text: str, name: str, *, secret: bool = False) -> bytes:
    """Return the 32 bytes of a key in base64; SettingsError, which does not show a `secret` one, if it is invalid."""
    text = text.strip()
    try:
        key = binascii.a2b_base64(text.encode("ascii"), strict_mode=True)
    except (binascii.Error, UnicodeEncodeError):
        key = b""
    # Base64 leaves two bits of the last character unused, but each key must have one spelling.
    if len(key) == KEY_BYTES and format_key(key) == text:
        return key
    seen = f"has {len(text)} characters" if secret else f"is {reprlib.repr(text)} ({len(text)} characters)"
    if len(text) == KEY_CHARACTERS:
        seen += " that are not base64 of 32 bytes"
    raise SettingsError(f"{name} {seen}; a key is {KEY_CHARACTERS} characters of base64 that end in '=' (32 bytes)")


def check_public(name: str, public: bytes) -> None:
    """Check that X25519 gives a secret with this public key.

    With a point of small order the result would be known to anyone (RFC 7748 §6.1). Raise SettingsError if the
    length is wrong or the point is of small order; the all-zero key is one. Raise UnavailableError if OpenSSL lacks
    the algorithms of sealed sessions.
    """
    _check_length(name, public)
    any_private = check_algorithms()
    try:
        any_private.exchange(X25519PublicKey.from_public_bytes(public))
    except ValueError:
        raise SettingsError(f"{name} {format_key(public)} is not a public key; no private key belongs to it") from None


@cache
def check_algorithms() -> X25519PrivateKey:
    """Return an unused private key; UnavailableError if OpenSSL lacks the algorithms, as in FIPS mode."""
    try:
        ChaCha20Poly1305(bytes(KEY_BYTES)).encrypt(bytes(12), b"", None)
        return X25519PrivateKey.from_private_bytes(bytes(KEY_BYTES))
    except UnsupportedAlgorithm as error:
        raise UnavailableError(
            "sealed sessions and their keys need X25519 and ChaCha20-Poly1305, and OpenSSL lacks one of them, as in"
            " FIPS mode; open sessions need neither"
        ) from error


def check_name(name: str) -> None:
    """Raise SettingsError unless this name is valid for a master."""
    if not name.strip() or not name.isprintable() or len(name.encode()) > NAME_BYTES:
        raise SettingsError(f"name is {reprlib.repr(name)}; it must be 1 to {NAME_BYTES} printable bytes")


def _check_length(name: str, key: bytes) -> None:
    if len(key) != KEY_BYTES:
        raise SettingsError(f"{name} has {len(key)} bytes; a key has {KEY_BYTES}")
