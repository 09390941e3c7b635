"""A scene in another program, which is asked by datagrams (``--scene udp:[HOST:]PORT``), without sockets.

Each position leaves as a map with ``position_m`` and ``t_us``. An answer is a datagram of `plain_datagrams`: an array
of the force ``[f, …]``, or a map with ``force_n`` and, so that late answers are noticed, the ``t_us`` of the position.
docs/use/scenes.md describes them for programs in any language.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_integer, check_parameter, meant
from hapticnet.errors import PeerError, SettingsError
from hapticnet.plain_datagrams import FORCE, JSON_OBJECT, MAP, POSITION, parse_program, read_vector, write
from hapticnet.samples import MAX_AXES, PositionSample, Vector

DECAY_US: Final = 20_000  # time [µs] from the deadline in which the force decays to zero: an assumption
RISE_US: Final = 100_000  # time [µs] in which it rises again once answers are in time: an assumption
MOST_UNANSWERED: Final = 4096  # most unanswered positions that are remembered; the oldest of them count
LINES_EVERY_US: Final = 10_000_000  # shortest time [µs] between two lines about the same
FORMS: Final = {"json": JSON_OBJECT, "msgpack": MAP}
KEYS: Final = ("axes", "deadline", "form")


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteSettings:
    """How to ask the program."""

    axes: int = 1
    # Longest time [s] that a position may wait for its answer; an assumption. After it the force decays.
    deadline_s: float = 0.02
    form: str = "json"  # of the questions: json or msgpack

    def __post_init__(self) -> None:
        check_integer("axes of the scene", self.axes, 1, MAX_AXES)
        check_parameter("deadline of the scene", self.deadline_s, 0.001, 10.0, "s")
        if self.form not in FORMS:
            raise SettingsError(
                f"form of the scene is {self.form!r}{meant(self.form, FORMS)}; it must be json or msgpack"
            )


def parse_remote(text: str) -> tuple[str, RemoteSettings]:
    """Return address and settings of ``udp:[HOST:]PORT[,axes=N][,deadline=SECONDS][,form=json|msgpack]``.

    Raise SettingsError if a key or a value is invalid; the address is not checked.
    """
    place, values = parse_program(text, "scene", KEYS)
    try:
        axes, deadline_s = int(values.get("axes", "1")), float(values.get("deadline", "0.02"))
    except ValueError:
        raise SettingsError(f"scene {text!r}: axes and deadline must be numbers, as in axes=3,deadline=0.05") from None
    return place, RemoteSettings(axes=axes, deadline_s=deadline_s, form=values.get("form", "json"))


class RemoteScene:
    """The newest force of a program that is asked with each position, but never waited for.

    The force is whole while no position has waited for its answer for longer than the deadline. Then it decays linearly
    to zero within `DECAY_US`, and once answers are in time again it rises within `RISE_US`. Without ``t_us``, an answer
    counts as that to the newest position. `place` names the program in messages.
    """

    def __init__(self, settings: RemoteSettings, place: str) -> None:
        self.settings, self.axes, self.place = settings, settings.axes, place
        # Counts: positions that were asked, answers with a force, answers to an older position than the one before,
        # datagrams without a force, times when the force began to decay, and positions at which it was not whole
        self.asked = self.answers = self.late = self.malformed = self.lapses = self.decayed = 0
        self._form = FORMS[settings.form]
        self._deadline_us = round(1e6 * settings.deadline_s)
        self._unanswered: deque[tuple[int, int]] = deque()  # time [µs] of each position, and when it was asked
        self._newest_us: int | None = None  # time of the newest position asked, and of the newest answered
        self._answered_us: int | None = None
        self._force_n: Vector = (0.0,) * self.axes
        self._share, self._now_us, self._lapsed = 1.0, 0, False
        self._lines: deque[str] = deque()
        self._told_us: dict[str, int] = {}

    def ask(self, sample: PositionSample, now_us: int) -> bytes:
        """Return the question about a position."""
        self.asked += 1
        self._newest_us = sample.t_us
        if len(self._unanswered) < MOST_UNANSWERED:
            self._unanswered.append((sample.t_us, now_us))
        return write(self._form, {POSITION.key: sample.position_m, "t_us": sample.t_us})

    def receive(self, data: bytes, now_us: int) -> None:
        """Process a datagram of the program. Never raises."""
        try:
            _, force_n, found = read_vector(data, FORCE, self.axes)
            t_us = self._answered_by(found.get("t_us"))
        except PeerError as error:
            self.malformed += 1
            self._tell("malformed", f"sent what is not a force: {error}", now_us)
            return
        self.answers += 1
        if self._answered_us is not None and t_us < self._answered_us:
            self.late += 1
            return
        self._answered_us, self._force_n = t_us, force_n
        while self._unanswered and self._unanswered[0][0] <= t_us:
            self._unanswered.popleft()

    def force_n(self, now_us: int) -> Vector:
        """Return the force [N] to apply at `now_us`."""
        late_us = now_us - self._unanswered[0][1] - self._deadline_us if self._unanswered else 0
        most = 1.0 if late_us <= 0 else max(0.0, 1.0 - late_us / DECAY_US)
        self._share = min(most, self._share + max(0, now_us - self._now_us) / RISE_US)
        self._now_us = now_us
        if (most < 1.0) is not self._lapsed:
            self._lapsed = most < 1.0
            self.lapses += self._lapsed
            late = f"does not answer within {self._deadline_us / 1e3:g} ms; the force decays to zero"
            self._tell(f"lapsed {self._lapsed}", late if self._lapsed else "answers again", now_us)
        if self._share == 1.0:
            return self._force_n
        self.decayed += 1
        return tuple([self._share * each for each in self._force_n])

    def next_line(self) -> str | None:
        """Return the next message for a person, or None."""
        return self._lines.popleft() if self._lines else None

    def report(self) -> dict[str, int]:
        """Return the counts for JSON."""
        names = "asked", "answers", "late", "malformed", "lapses", "decayed"
        return {name: getattr(self, name) for name in names}

    def _answered_by(self, t_us: object) -> int:
        """Return the time of the position that an answer with this ``t_us`` answers; PeerError if there is none."""
        if t_us is None:
            t_us = self._newest_us
        if self._newest_us is None or type(t_us) is not int or t_us > self._newest_us:
            raise PeerError(f"t_us is {str(t_us)[:30]}; it must be that of a position, or left out")
        return t_us

    def _tell(self, about: str, line: str, now_us: int) -> None:
        """Tell a person a line, unless there was one about the same lately, whatever that said."""
        if now_us - self._told_us.get(about, -LINES_EVERY_US) >= LINES_EVERY_US:
            self._told_us[about] = now_us
            self._lines.append(f"the scene at {self.place} {line}")
