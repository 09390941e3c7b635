"""A peer as a child process: its declaration, and the lines that drive it (README.md)."""

import contextlib
import fcntl
import shutil
import struct
import subprocess
import tempfile
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

PEERS: Final = Path(__file__).parents[1]
AT_ONCE: Final = 32_000
"""Most bytes of commands whose answers are not read yet: less than a pipe holds, so that nobody waits for the other."""


class ChildError(Exception):
    """A peer answered an error, or ended."""


def write_float(value: float) -> str:
    """Return the 16 hex digits of a double."""
    return struct.pack(">d", value).hex()


def read_float(digits: str) -> float:
    """Return the double of 16 hex digits."""
    (value,) = struct.unpack(">d", bytes.fromhex(digits))
    return float(value)


def write_floats(values: Iterable[float]) -> str:
    """Return the digits of doubles, separated by spaces."""
    return " ".join(map(write_float, values))


def write_hex(data: bytes | str) -> str:
    """Return the hex digits of bytes or a text; a hyphen if it is empty."""
    return (data.encode() if isinstance(data, str) else data).hex() or "-"


def read_hex(digits: str) -> bytes:
    """Return the bytes of hex digits or of a hyphen."""
    return b"" if digits == "-" else bytes.fromhex(digits)


@dataclass(frozen=True)
class Peer:
    """What `peer.toml` says of a peer, and where it was built."""

    folder: Path
    name: str
    start: tuple[str, ...]
    needs: tuple[str, ...] = ()
    build: tuple[str, ...] = ()
    smallest_master: str | None = None
    size: tuple[str, ...] = ()
    size_of: str = ""

    def missing(self) -> list[str]:
        """Return the programs that it needs and that are not here."""
        return [program for program in self.needs if shutil.which(program) is None]

    def built(self, root: Path) -> Path:
        """Build it in a folder of `root`, once for all processes; return the folder. Raise ChildError if that fails."""
        folder = root / self.folder.name
        folder.mkdir(parents=True, exist_ok=True)
        done = folder / ".built"
        with (root / f"{self.folder.name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if self.build and not done.exists():
                made = subprocess.run(
                    self.command(self.build, folder), cwd=self.folder, capture_output=True, text=True, check=False
                )
                if made.returncode != 0:
                    raise ChildError(f"{self.name} cannot be built: {made.stdout[-2000:]}{made.stderr[-4000:]}")
                done.touch()
        return folder

    def command(self, words: Sequence[str], build: Path) -> list[str]:
        """Return a command of the declaration, with the folder where it was built."""
        return [word.replace("{build}", str(build)) for word in words]


def find_peers() -> list[Peer]:
    """Return the peers that have a declaration."""
    found = []
    for path in sorted(PEERS.glob("*/peer.toml")):
        fields = tomllib.loads(path.read_text())
        known: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()
        }
        found.append(Peer(path.parent, **known))
    return found


class Child:
    """A running peer. Commands are written at once or later, and answered in their order."""

    def __init__(self, peer: Peer, build: Path) -> None:
        self.peer = peer
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the child
        self._process = subprocess.Popen(
            peer.command(peer.start, build),
            cwd=peer.folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
        )
        self._later: list[str] = []
        self.features = dict(field.split("=", 1) for field in self.ask("features"))

    def has(self, feature: str, value: str) -> bool:
        """Return whether a value is in a list of its features, such as ``has("codecs", "raw")``."""
        return value in self.features.get(feature, "").split(",")

    @property
    def is_alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def tell(self, *fields: object) -> None:
        """Send a command whose answer has no fields; it may wait until the next command whose answer has some."""
        self._later.append(" ".join(map(str, fields)))

    def ask(self, *fields: object) -> list[str]:
        """Return the fields of the answer to a command; raise ChildError if it, or one told before, is an error."""
        self.tell(*fields)
        lines, self._later = self._later, []
        answers = self.batch(lines)
        for line, answer in zip(lines, answers, strict=True):
            self.check(answer, line)
        return answers[-1].split(" ")[1:]

    def check(self, answer: str, line: str = "a command") -> None:
        """Raise ChildError if an answer is an error."""
        if answer.split(" ", 1)[0] != "ok":
            raise ChildError(f"{self.peer.name} answers {answer!r} to {line[:200]!r}")

    def batch(self, lines: Sequence[str]) -> list[str]:
        """Return the answers to commands."""
        answers: list[str] = []
        first = size = 0
        for i, line in enumerate(lines):
            if size + len(line) >= AT_ONCE:
                answers += self._exchange(lines[first:i])
                first, size = i, 0
            size += len(line) + 1
        return answers + self._exchange(lines[first:])

    def _exchange(self, lines: Sequence[str]) -> list[str]:
        into, out = self._process.stdin, self._process.stdout
        assert into is not None
        assert out is not None
        try:
            into.write("".join(f"{line}\n" for line in lines).encode())
            into.flush()
        except BrokenPipeError:
            raise self._ended(lines[0]) from None
        answers = []
        for line in lines:
            answer = out.readline()
            if not answer.endswith(b"\n"):
                raise self._ended(line)
            answers.append(answer.decode("ascii", "replace").rstrip("\r\n"))
        return answers

    def _ended(self, line: str) -> ChildError:
        code = self._process.wait(10)
        self._errors.seek(0)
        said = self._errors.read()[-2000:].decode(errors="replace")
        return ChildError(f"{self.peer.name} ended with code {code} at {line[:200]!r}: {said}")

    def end(self) -> int:
        """Close its input; return its exit code."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            return self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()
        finally:
            self._process.stdout.close()
            self._errors.close()
