"""Parse ``--operator`` and make the operator."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hapticnet.files import user_path

if TYPE_CHECKING:
    from hapticnet.node.events import NodeEvent
    from hapticnet.operator.base import Operator
    from hapticnet.operator.yielding import HandSpec
    from hapticnet.runtime.udp import HostPort
    from hapticnet.runtime.watching import Watcher
    from hapticnet.user_code import UserClass

OPERATORS: Final = (
    "scripted, palpation[:axes=2], hand:NAME[,KEY=VALUE…], page[:axes=N], trace:FILE[:COLUMN,…],"
    " udp:[HOST:]PORT[,axes=N], haply[:HOST:PORT][,KEY=VALUE…], FILE.py:CLASS[:KEY=VALUE,…] and"
    " package.module:CLASS[:KEY=VALUE,…]"
)


@dataclass(frozen=True, slots=True)
class Hand:
    """An operator, and the helpers that must run beside it."""

    operator: "Operator"
    file: Path | None = None  # the file that it reads, or None
    watchers: "list[Watcher[NodeEvent]]" = field(default_factory=list)

    def report(self) -> dict[str, Any] | None:
        """Return the operator's report for JSON, or None."""
        from hapticnet.operator.haply import HaplyOperator
        from hapticnet.operator.remote import RemoteOperator

        return self.operator.report() if isinstance(self.operator, (HaplyOperator, RemoteOperator)) else None


def make_operator(
    spec: str, *, insertions: int, seed: int, say: Callable[[str], None], warn: Callable[[str], None]
) -> Hand:
    """Return the operator written as `spec`; `say` is called with notes about it, `warn` with warnings.

    Raise SettingsError if there is no such operator, or the user's class cannot be used; FileError if its file
    cannot be used; UnavailableError if its socket cannot be opened.
    """
    import numpy as np

    from hapticnet.operator.base import UserOperator
    from hapticnet.operator.haply import is_haply
    from hapticnet.operator.live import LiveHand, LiveHandSettings
    from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
    from hapticnet.operator.trace import load_trace
    from hapticnet.operator.yielding import is_hand, parse_hand
    from hapticnet.runtime.watching import Closing

    found = check_operator(spec)
    if found is not None:
        made = found.make()
        return Hand(UserOperator(made, found.label), found.file, [Closing(made, found.label, warn)])
    kind, _, rest = spec.partition(":")
    if is_hand(spec):
        wanted = parse_hand(spec)
        made = make_operator(_motion(wanted), insertions=insertions, seed=seed, say=say, warn=warn)
        return replace(made, operator=wanted.holding(made.operator))
    if is_haply(spec):
        return _haply(spec, say, warn)
    if kind == "page":
        return Hand(LiveHand(LiveHandSettings(axes=int(rest[-1:] or 1))))
    if spec == "scripted":
        return Hand(ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng([seed, 3])))
    if kind == "palpation":
        from hapticnet.operator.scripted import PalpatingOperator, PalpationSettings

        motion = PalpationSettings(palpations=insertions, axes=2 if rest == "axes=2" else 3)
        return Hand(PalpatingOperator(motion, np.random.default_rng([seed, 3])))
    if kind == "trace":
        file, columns = _trace(rest)
        operator, notes = load_trace(file, position=columns)
        for note in notes:
            say(f"{file}: {note}")
        return Hand(operator, file)
    return _remote(spec, say, warn)


def check_operator(spec: str) -> "UserClass | None":
    """Return the user's class that `spec` names, or None for an operator of hapticnet.

    Files and sockets are not opened.

    Raise SettingsError if there is no such operator, or the user's class cannot be imported.
    """
    from hapticnet.checks import meant
    from hapticnet.errors import SettingsError
    from hapticnet.operator.haply import is_haply, parse_haply
    from hapticnet.operator.yielding import is_hand, parse_hand
    from hapticnet.runtime.udp import parse_host_port
    from hapticnet.user_code import find_user_class

    if is_hand(spec):
        motion = _motion(parse_hand(spec))
        if is_haply(motion) or motion.partition(":")[0] in ("hand", "page", "udp"):
            raise SettingsError(f"{spec!r}: no hand intends {motion!r}; try scripted, palpation, trace:FILE or a class")
        check_operator(motion)
        return None
    if is_haply(spec):
        parse_host_port(parse_haply(spec)[0])
        return None
    kind, _, rest = spec.partition(":")
    if kind == "page" and rest not in ("", "axes=1", "axes=2", "axes=3"):
        raise SettingsError(f"operator {spec!r}: expected page, page:axes=2 or page:axes=3")
    if kind == "palpation" and rest not in ("", "axes=2", "axes=3"):
        raise SettingsError(f"operator {spec!r}: expected palpation, palpation:axes=2 or palpation:axes=3")
    if kind == "udp" and rest:
        _remote_address(spec)
    elif not (spec == "scripted" or kind in ("page", "palpation") or (kind == "trace" and rest)):
        found = find_user_class(spec, "operator")
        if found is None:
            names = "scripted", "palpation", "hand", "page", "trace", "udp", "haply"
            raise SettingsError(f"unknown operator {spec!r}{meant(kind, names)}; there are: {OPERATORS}")
        return found
    return None


def _motion(wanted: "HandSpec") -> str:
    """Return the text of the operator that moves as a hand intends; SettingsError if it has other axes."""
    from hapticnet.errors import SettingsError

    if wanted.motion and wanted.axes is not None:
        raise SettingsError("a hand has axes or a motion, not both: the motion has its own axes")
    return wanted.motion or ("scripted" if wanted.axes in (None, 1) else f"palpation:axes={wanted.axes}")


def _haply(spec: str, say: Callable[[str], None], warn: Callable[[str], None]) -> Hand:
    """Return the operator on an Inverse3; it connects when the run starts."""
    from hapticnet.errors import UnavailableError
    from hapticnet.operator.haply import HaplyOperator, parse_haply

    try:
        from hapticnet.runtime.haply_port import HaplyPort
    except ModuleNotFoundError as error:
        raise UnavailableError("operator haply needs aiohttp (extra web): pip install aiohttp") from error
    address, settings = parse_haply(spec)
    if not address.startswith(("127.", "localhost:", "[::1]:")):
        warn(f"whoever answers at {address} can move the tool; the connection there is not encrypted")
    operator = HaplyOperator(settings)
    return Hand(operator, None, [HaplyPort(operator, address, say, warn)])


def _remote(spec: str, say: Callable[[str], None], warn: Callable[[str], None]) -> Hand:
    """Return the operator of a program, with its socket open."""
    from hapticnet.operator.remote import RemoteOperator
    from hapticnet.runtime.hand_port import HandPort
    from hapticnet.runtime.udp import bound_address, is_loopback, listen

    address, axes = _remote_address(spec)
    operator = RemoteOperator(axes)
    sock = listen(address)
    bound = bound_address(sock)
    say(f"positions are read from {bound}" + ("" if axes == 1 else f", {axes} axes"))
    if not is_loopback(sock.getsockname()):
        warn(f"anyone who reaches {bound} can move the tool; datagrams there are neither encrypted nor checked")
    return Hand(operator, None, [HandPort(operator, sock, say)])


def _remote_address(spec: str) -> "tuple[HostPort, int]":
    """Return address and axes of udp:[HOST:]PORT[,axes=N]."""
    from hapticnet.errors import SettingsError
    from hapticnet.plain_datagrams import parse_program
    from hapticnet.runtime.udp import parse_host_port

    place, values = parse_program(spec, "operator", ("axes",))
    axes = values.get("axes", "1")
    if axes not in ("1", "2", "3"):
        raise SettingsError(f"operator {spec!r}: axes is {axes!r}; it must be 1, 2 or 3")
    return parse_host_port(place, lowest_port=0), int(axes)


def _trace(whole: str) -> tuple[Path, str | None]:
    """Return file and columns of FILE[:COLUMN,…]; a file may have a colon in its name."""
    file, colon, columns = whole.rpartition(":")
    chosen = bool(colon) and not user_path(whole).exists()
    return (user_path(file), columns) if chosen else (user_path(whole), None)
