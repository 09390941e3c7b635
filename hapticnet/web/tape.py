"""A recording prepared to be shown at any time: what the live page shows, computed once for the whole recording.

Counters are sums from the beginning, so the figures at a time are differences of two of them, whatever was shown
before. An hour at 1 kHz takes 0.6 GB, and 0.9 GB while it is read.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import FileError, HapticnetError
from hapticnet.measure.metrics import error_report, norms
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind
from hapticnet.recordings.loading import Recording
from hapticnet.recordings.session.session import (
    IN_FORCE,
    INCOMPLETE,
    Event,
    Session,
    in_force,
    parse_json,
    settings_line,
)
from hapticnet.samples import MAX_AXES
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.settings import BodySceneSettings
from hapticnet.web import messages
from hapticnet.web.mirror import Mirror, built_in, scene_called
from hapticnet.web.traffic import raw_wire_bytes

COLUMNS: Final = ("true", "received", "held", "sensed", "error", "packets")
FRAMES_PER_S: Final = 60  # at most, of tool and surfaces
ROWS_PER_BLOCK: Final = 2_000  # about that many rows are sent at once, of a second at most
LARGEST: Final = 1e9  # larger numbers are shown as unknown
MOST_EVENTS: Final = 1_000  # events that a page gets
LONGEST_EVENT: Final = 4000  # characters of one
_AXIS: Final = re.compile(r"_[xyz](?=_(m|rad)$)")
_SIDES: Final = {"master": ("displacement_m", 3), "slave": ("answered_us", 4)}  # last column, columns after the held


class Span(NamedTuple):
    """Settings that were in force from a row on."""

    row: int
    codec: str
    law: WeberLaw
    scene: str
    line: str  # in words


@dataclass(slots=True)
class Tape:
    """The rows of a recording, and all that a page shows of them."""

    path: Path
    kind: str  # master, slave, or foreign: a force from another program
    t_us: IntArray  # shape (n,), n ≥ 1, each later than the one before
    position_m: FloatArray  # shape (n, axes)
    vectors: dict[str, FloatArray]  # true, received and held force [N], shape (n, axes), as far as they are recorded
    sensed_n: FloatArray | None = None
    back: IntArray = field(default_factory=lambda: np.empty((0, 3), np.int64))  # from the slave: time, kind, bytes
    events: tuple[Event, ...] = ()
    about: Mapping[str, Any] = field(default_factory=dict)
    unix_offset_us: int | None = None
    notes: list[str] = field(default_factory=list)
    rate_hz: float = field(init=False)  # usual rows a second
    spans: list[Span] = field(init=False)
    rows: npt.NDArray[np.float32] = field(init=False)  # `COLUMNS`, shape (columns, n)
    scenes: list[dict[str, Any]] = field(default_factory=list)  # scene messages, each with its time
    shapes: list[Any] = field(default_factory=list)
    frames: tuple[npt.NDArray[Any], ...] = field(init=False)  # `FRAMES_PER_S`: row, surfaces and contacts
    sums: dict[str, npt.NDArray[np.uint32]] = field(init=False)  # of all rows before a row, shape (n + 1,)
    _raw_bytes: int = field(init=False)  # of a packet with a raw force

    def __post_init__(self) -> None:
        self.rate_hz = 1e6 / float(np.median(np.diff(self.t_us))) if len(self.t_us) > 1 else 1.0
        self.spans = list(self._settings())
        self._follow_scenes()
        self._count(*self._compare())
        self.vectors = {"held": self.vectors["held"]} if self.axes > 1 and "held" in self.vectors else {}

    @property
    def axes(self) -> int:
        """Number of axes that are shown."""
        return int(self.position_m.shape[1])

    @property
    def block_us(self) -> int:
        """Time [µs] that a block takes."""
        return max(1, round(1e6 * min(1.0, ROWS_PER_BLOCK / self.rate_hz)))

    def figures(self, t_us: int) -> dict[str, Any]:
        """Return traffic and felt error at a time, as far as they are recorded; see `hapticnet.web.replay`."""
        row = int(np.searchsorted(self.t_us, t_us, side="right"))
        span = next((span for span in reversed(self.spans) if span.row < row), None)
        since = span.row if span is not None else 0
        figures: dict[str, Any] = {"felt": None}
        figures["traffic"] = self._traffic(t_us, row, since) if len(self.back) else None
        first = max(since, int(np.searchsorted(self.t_us, t_us - round(1e6 * messages.HISTORY_S), side="right")))
        known = np.flatnonzero(np.isfinite(self.rows[4, first:row])) + first
        if len(known) and span is not None:
            held = np.abs(self.rows[2, known].astype(np.float64))
            error = self.rows[4, known].astype(np.float64)
            felt = error_report(span.law, (held + error)[:, None], held[:, None])
            figures["felt"] = asdict(felt) | {"so_far": self._above_jnd(row)}
        return figures

    def summary(self) -> dict[str, Any]:
        """Return a summary of the whole recording: packets a second, and the share of the time above one JND."""
        felt_s = int(self.sums["raw_packets"][-1]) / self.rate_hz
        whole_s = max(self._seconds(len(self.t_us) - 1), 1 / self.rate_hz)
        rate = int(self.sums["packets"][-1]) / felt_s if felt_s else len(self.back) / whole_s
        return {
            "codecs": list(dict.fromkeys(span.codec for span in self.spans)),
            "is_felt": felt_s > 0,
            "packets_per_s": round(rate, 1) if len(self.back) else None,
            "raw_per_s": round(self.rate_hz, 1),
            "above_jnd": self._above_jnd(len(self.t_us)),
        }

    def block(self, number: int) -> tuple[float, FloatArray, tuple[npt.NDArray[Any], ...]]:
        """Return the time [s] at which a block begins, its rows (their time first, shape (c, r)), and its frames.

        The frames are time, tool and, with several axes, held force, surfaces, and contacts, each of shape (f, …).
        """
        begin_us = int(self.t_us[0]) + number * self.block_us
        first, last = np.searchsorted(self.t_us, [begin_us, begin_us + self.block_us])
        columns: FloatArray = np.vstack([1e-6 * (self.t_us[first:last] - begin_us), self.rows[:, first:last]])
        rows, surfaces, contacts = self.frames
        chosen = slice(*np.searchsorted(rows, [first, last]))
        at = rows[chosen]
        held = self.vectors.get("held", np.empty((len(self.t_us), 0)))[at]
        frames = 1e-6 * (self.t_us[at, None] - begin_us), self.position_m[at], held, surfaces[chosen], contacts[chosen]
        return 1e-6 * number * self.block_us, columns, frames

    def description(self, label: str) -> dict[str, Any]:
        """Return the description that a page gets first; times count from its first row."""
        first_us = int(self.t_us[0])
        last_s = self._seconds(len(self.t_us) - 1)
        events = [  # the last ones, such as the end, come after the last row
            (min(1e-6 * (each.t_us - first_us), last_s), each.name, each.text[:LONGEST_EVENT])
            for each in self.events
            if each.name != IN_FORCE
        ]
        return {
            "label": label, "name": self.path.name, "kind": self.kind, "notes": self.notes,
            "summary": self.summary(),
            "unix_s": None if self.unix_offset_us is None else (first_us + self.unix_offset_us) / 1e6,
            "axes": self.axes, "block_s": self.block_us / 1e6, "duration_s": last_s,
            "columns": ["t", *COLUMNS], "scenes": self.scenes, "shapes": self.shapes,
            "known": [name for name, row in zip(COLUMNS, self.rows, strict=True) if np.isfinite(row).any()],
            "top_n": float(np.fmax.reduce(self.rows[:4], axis=None, initial=0.0)),
            "bottom_n": float(np.fmin.reduce(self.rows[:4], axis=None, initial=0.0)),
            "spans": [one._asdict() | {"t_s": self._seconds(one.row), "law": asdict(one.law)} for one in self.spans],
            "events": events[:MOST_EVENTS],
        }  # fmt: skip

    def _seconds(self, row: int) -> float:
        return (int(self.t_us[min(row, len(self.t_us) - 1)]) - int(self.t_us[0])) / 1e6

    def _above_jnd(self, row: int) -> float | None:
        known = int(self.sums["known"][row])
        return int(self.sums["above"][row]) / known if known else None

    def _traffic(self, t_us: int, row: int, since: int) -> dict[str, float]:
        """Return rates of the last second, and totals while a force was felt since the settings last changed."""
        then_us = t_us - 1_000_000
        first, last = np.searchsorted(self.back[:, 0], [then_us, t_us], side="right")
        before = int(np.searchsorted(self.t_us, then_us, side="right"))
        elapsed_s = min(1.0, max(0.2, (t_us - int(self.t_us[0])) / 1e6))
        counts = float(last - first), float(self.back[first:last, 2].sum()), float(row - before)
        rates = dict(zip(("packets", "bytes", "raw_packets"), counts, strict=True))
        totals: dict[str, float] = {name: int(self.sums[name][row]) - int(self.sums[name][since]) for name in rates}
        for each in (rates, totals):
            each["raw_bytes"] = each["raw_packets"] * self._raw_bytes
        return totals | {f"{name}_per_s": round(rate / elapsed_s, 1) for name, rate in rates.items()}

    def _settings(self) -> Iterator[Span]:
        """Yield the settings in force, each from its row on; a foreign file has none."""
        for t_us, settings in in_force(self.events):
            numbers = {name: settings.get(name) for name in ("weber_fraction", "floor_n", "multiplier")}
            try:
                law = WeberLaw(**{name: each for name, each in numbers.items() if isinstance(each, (int, float))})
                line = settings_line(settings)
            except (HapticnetError, ValueError, TypeError):
                self.notes.append("some of its settings in force are damaged and were left out")
                continue
            row = int(np.searchsorted(self.t_us, t_us))
            yield Span(row, str(settings.get("codec"))[:40], law, str(settings.get("scene")), line)

    def _follow_scenes(self) -> None:
        """Move a copy of each scene along; keep how it looks, and the true force where it is not recorded."""
        first_scene = self.spans[0].scene if self.spans else ""
        begun = {0: (first_scene, self.kind == "slave")}  # scene, and whether it is new, by the row from which it is
        for event in self.events:
            if event.name == "Connected":
                with suppress(ValueError, KeyError, TypeError):  # a damaged one begins none
                    grant = parse_json(event.text)["grant"]
                    row = int(np.searchsorted(self.t_us, event.t_us))
                    begun[row] = str(grant["scene"]), grant["resumed"] is False
        begun = dict(sorted(each for each in begun.items() if each[0] < len(self.t_us)))
        stride = max(1, round(self.rate_hz / FRAMES_PER_S))
        true_n = np.full(len(self.t_us), np.nan)
        at: list[int] = []
        surfaces: list[tuple[float, ...]] = []
        contacts: list[tuple[int, ...]] = []
        for (first, (name, is_new)), end in zip(begun.items(), [*begun, len(self.t_us)][1:], strict=True):
            known = scene_called(name) if self.axes == 1 else None
            mirror = None if known is None else Mirror(known, is_new=is_new)
            self.scenes.append({"t_s": self._seconds(first), **self._scene(name, mirror)})
            for low, high in pairwise([first, *range(first + 1, end, stride), end]):
                at.append(high - 1)
                if mirror is not None:
                    positions_m = self.position_m[low:high, 0].astype("f4").tolist()  # as the slave gets them
                    true_n[low:high] = mirror.forces_n(self.t_us[low:high].tolist(), positions_m)
                surfaces.append(() if mirror is None else mirror.scene.surfaces_m())
                contacts.append(() if mirror is None else mirror.scene.contacts())
        self.frames = np.array(at), _padded(surfaces, "f4"), _padded(contacts, "u1")
        if "true" not in self.vectors and np.isfinite(true_n).any():
            self.vectors["true"] = true_n[:, None]

    def _scene(self, name: str, mirror: Mirror | None) -> dict[str, Any]:
        """Return a scene message for a scene, and keep the shapes of one of bodies."""
        tissues = () if mirror is None else mirror.settings.tissues
        keys = ("name", "stiffness_n_per_m", "breach_force_n")
        shown = [{"rest_m": each.rest_position_m} | {key: getattr(each, key) for key in keys} for each in tissues]
        low, high = float(self.position_m[:, 0].min()), float(self.position_m[:, 0].max())
        range_m = (low, max(high, low + 0.01)) if mirror is None else mirror.range_m
        bodies = built_in(name)
        if isinstance(bodies, BodySceneSettings) and bodies.axes == self.axes and not self.shapes:
            self.shapes = list(BodyScene(bodies.bodies, name=name).shapes())
        about = {"known": mirror is not None, "name": name, "axes": self.axes, "reach_m": 0.05}
        return {**about, "range_m": range_m, "tissues": shown}

    def _compare(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Put what a page plots into `rows`; return where the felt error is known, and where it is above one JND."""
        count = len(self.t_us)
        self.rows = np.full((len(COLUMNS), count), np.nan, np.float32)
        for index, name in enumerate(COLUMNS[:3]):
            if (vector := self.vectors.get(name)) is not None:
                self.rows[index] = vector[:, 0] if self.axes == 1 else norms(vector)
        if self.sensed_n is not None:
            self.rows[3] = self.sensed_n
        above = known = np.zeros(count, bool)
        if "true" in self.vectors and "held" in self.vectors and self.spans:
            error = norms(self.vectors["true"] - self.vectors["held"])
            self.rows[4] = error
            parts = np.split(norms(self.vectors["held"]), [span.row for span in self.spans[1:]])
            jnds_n = [span.law.jnds_n(held) for span, held in zip(self.spans, parts, strict=True)]
            known, above = np.isfinite(error), error > np.concatenate(jnds_n)
        return known, above

    def _count(self, known: npt.NDArray[np.bool_], above: npt.NDArray[np.bool_]) -> None:
        """Sum up packets and bytes of all rows, and of those in which a force was felt."""
        arrived = np.searchsorted(self.back[:, 0], self.t_us, side="right")
        packets = np.diff(arrived, prepend=0)
        total = np.concatenate([[0], np.cumsum(self.back[:, 2])])
        sizes = np.diff(total[arrived], prepend=0)
        forces = np.concatenate([[0], np.cumsum(self.back[:, 1] == int(Kind.FORCE))])
        self.rows[5] = np.diff(forces[arrived], prepend=0) if len(self.back) else np.nan
        self._raw_bytes = raw_wire_bytes(len(self.t_us), self.axes, sealed=self.about.get("sealed") is True)
        felt = np.abs(np.nan_to_num(self.rows[1])) > 0.0
        counts = {"packets": packets * felt, "bytes": sizes * felt, "raw_packets": felt, "known": known, "above": above}
        self.sums = {name: np.cumsum(np.append(0, each), dtype=np.uint32) for name, each in counts.items()}


def tape_of_session(path: Path, session: Session) -> Tape:
    """Return a recording of a master or slave; FileError if there is nothing to show in it."""
    columns, side = session.main, session.side
    if side not in _SIDES or not len(columns["t_us"]):
        raise FileError(f"{path}: it has no rows, so there is nothing to replay")
    last, after = _SIDES[side]
    names = list(columns)
    most, rest = divmod(len(names) - 1 - after, 3)
    if most < 1 or rest or last not in names:
        raise FileError(f"{path}: its columns are not those of a {side}: {', '.join(names[:20])}")
    stems = [_AXIS.sub("", name) for name in names[1 : 1 + most]]
    axes = stems[:MAX_AXES].count(stems[0])
    keep = _in_order(columns["t_us"])

    def vector(quantity: int) -> FloatArray:
        start = 1 + quantity * most
        return np.stack([_bounded(columns[name][keep]) for name in names[start : start + axes]], axis=1)

    held = vector(2)
    vectors = {"held": held, "received": vector(1)} if side == "master" else {"held": held, "received": held}
    notes = []
    if not session.is_whole:
        notes.append("the file is cut off or damaged: what is whole of it is shown")
    elif not session.complete:
        why = session.about.get(INCOMPLETE, "the recording stopped before its session ended")
        notes.append(f"incomplete: {why}")
    if side == "slave":
        vectors["true"] = vector(1)
        notes.append("a slave's recording: held is what the master holds if nothing is lost, packets are those sent")
    if axes < most:
        notes.append(f"only the first of its parts is shown: {stems[0].rpartition('_')[0]}")
    return Tape(
        path, side, columns["t_us"][keep].astype(np.int64), _without_gaps(vector(0)), vectors,
        sensed_n=_bounded(columns[names[-2]][keep]) if side == "master" and columns[names[-2]].any() else None,
        back=_back(session), events=tuple(sorted(session.events, key=lambda event: event.t_us)), about=session.about,
        unix_offset_us=session.unix_offset_us, notes=notes,
    )  # fmt: skip


def tape_of_force(path: Path, recording: Recording) -> Tape:
    """Return the force that another program recorded."""
    keep = _in_order(recording.t_us)
    force = recording.force[keep]
    notes = ["not recorded by hapticnet: it has no held force, no packets and no scene", *recording.notes]
    if recording.position is None:
        notes.append("it has no positions, so the tool does not move")
    position = np.zeros_like(force) if recording.position is None else recording.position[keep]
    return Tape(path, "foreign", recording.t_us[keep], _without_gaps(position), {"true": force}, notes=notes)


def _back(session: Session) -> IntArray:
    """Return the datagrams that the slave sent, as far as they are known here: time, kind and bytes with headers."""
    found = session.tables.get("datagram")
    if found is None or not {"direction", "kind", "datagram_bytes"} <= set(found):
        return np.empty((0, 3), np.int64)
    chosen = found["direction"] == (0 if session.side == "master" else 1)
    chosen &= found["kind"] != int(Kind.NOTICE)  # how the scene looks, which the live page does not count either
    datagrams: IntArray = np.stack(
        [found[name][chosen].astype(np.int64) for name in ("t_us", "kind", "datagram_bytes")], axis=1
    )
    datagrams[:, 2] += UDP_IPV4_HEADER_BYTES
    return datagrams[np.argsort(datagrams[:, 0], kind="stable")]


def _in_order(t_us: IntArray) -> Any:
    """Return an index of the rows in order of time; of rows of the same time, the last counts."""
    if np.all(t_us[1:] > t_us[:-1]):
        return slice(None)  # which copies nothing
    return len(t_us) - 1 - np.unique(t_us[::-1], return_index=True)[1]


def _bounded(values: FloatArray) -> FloatArray:
    """Return values with NaN for those that no page can show."""
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def _without_gaps(position_m: FloatArray) -> FloatArray:
    """Return positions with each unknown one replaced by the last known one."""
    for column in position_m.T:
        last = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), 0))
        column[:] = np.nan_to_num(column[last])
    return position_m


def _padded(rows: Sequence[Sequence[float]], kind: str) -> npt.NDArray[Any]:
    """Return rows of different lengths as an array, with 0 after the shorter ones."""
    return np.array(list(zip_longest(*rows, fillvalue=0)), kind).reshape(-1, len(rows)).T


def together(tapes: list[Tape]) -> bool:
    """Return whether two recordings were made at the same time and on the same clock, so that moments correspond."""
    offsets = [each.unix_offset_us for each in tapes if each.unix_offset_us is not None]
    overlap_us = min(int(each.t_us[-1]) for each in tapes) - max(int(each.t_us[0]) for each in tapes)
    return len(offsets) == 2 and overlap_us > 0 and abs(offsets[0] - offsets[1]) < 5_000_000
