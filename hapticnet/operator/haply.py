"""A Haply Inverse3 as hand and actuator, through Haply's local service (``--operator haply``), without sockets.

The service sends an inventory when one connects, and then one state of all its devices for each message that it gets
(docs.haply.co/inverseSDK/service/realtime, read in November 2026). Positions are metres and forces newtons in its
frame: x to the right, y forward, z up. It applies a force once: a client that stops sending has set it to zero.
"""

import json
from collections import deque
from dataclasses import dataclass
from typing import Any, Final

from hapticnet.capabilities import Capabilities
from hapticnet.checks import check_integer, check_parameter, meant
from hapticnet.errors import PeerError, SettingsError
from hapticnet.samples import PositionSample, Vector, new_tuple

ADDRESS: Final = "127.0.0.1:10001"
DIRECTIONS: Final = ("x", "y", "z", "-x", "-y", "-z")

USUAL_N: Final = 2.0
"""Largest force [N] unless the user says otherwise: the limit of Isaac Lab's driver for this device (`limit_force`).
Haply's data sheet could not be read."""
HIGHEST_N: Final = 10.0  # largest force [N] that a user may ask for: an assumption
SLEW_N_PER_S: Final = 200.0  # largest rise of the force: an assumption; a wall of 2 kN/m at 0.1 m/s
TRAVEL_M: Final = 0.2  # how far the handle moves on each axis: an assumption, as Haply's data sheet could not be read
RISE_US: Final = 500_000  # time [µs] in which the limit rises from zero once the hand holds the tool: an assumption
LONGEST_STEP_US: Final = 5_000  # longest time [µs] between two commands that lets the force rise
FELT_US: Final = 100_000  # age [µs] from which a force is not applied: the master asks in every tick
FARTHEST_M: Final = 1.0  # largest plausible coordinate [m]; the arms reach less than half of it
SLOW_US: Final = 2_000  # mean time [µs] to an answer from which it is said
LINES_EVERY_US: Final = 10_000_000  # shortest time [µs] between two equal lines

GRIPS: Final = ("wireless_verse_grip", "custom_verse_grip", "verse_grip")
KEYS: Final = {"axes": "axes", "axis": "axis", "max-force": "max_force_n", "button": "button"}


@dataclass(frozen=True, slots=True, kw_only=True)
class HaplySettings:
    """How the motion of the device moves the tool."""

    axes: int = 1
    axis: str = "-z"  # direction of the device that leads into the tissue
    max_force_n: float = USUAL_N
    button: str = "a"  # of a wireless handle, held to move the device without the tool; a wired handle has only one

    def __post_init__(self) -> None:
        check_integer("axes of the Inverse3", self.axes, 1, 3)
        for name, given, known in (("axis", self.axis, DIRECTIONS), ("button", self.button, "abc")):
            if given not in tuple(known):
                raise SettingsError(f"{name} of the Inverse3 is {given!r}; there are: {', '.join(known)}")
        check_parameter("largest force of the Inverse3", self.max_force_n, 0.1, HIGHEST_N, "N")


def is_haply(text: str) -> bool:
    """Return whether the text of an operator names an Inverse3."""
    return text.partition(",")[0].partition(":")[0] == "haply"


def parse_haply(text: str) -> tuple[str, HaplySettings]:
    """Return address and settings of ``haply[:HOST:PORT][,KEY=VALUE…]``; SettingsError if they are invalid."""
    place, *parts = text.split(",")
    values: dict[str, Any] = {}
    for part in parts:
        key, _, value = (each.strip() for each in part.partition("="))
        if key not in KEYS:
            raise SettingsError(f"operator haply has no {key!r}{meant(key, KEYS)}; there are: {', '.join(KEYS)}")
        try:
            values[KEYS[key]] = value if key in ("axis", "button") else (int if key == "axes" else float)(value)
        except ValueError:
            raise SettingsError(f"operator haply: {part!r} must be KEY=NUMBER, as in max-force=1") from None
    return place.partition(":")[2] or ADDRESS, HaplySettings(**values)


def read_state(data: str | bytes, device_id: str | None, button: str) -> tuple[str, Vector, bool] | None:
    """Return name, x, y, z [m] and whether the button is held, of the Inverse3 with this name (None: of the first).

    Return None if there is none; raise PeerError if its state is invalid.
    """
    try:
        found: Any = json.loads(data)
    except (ValueError, RecursionError):
        raise PeerError("the Haply service sent what is not JSON") from None
    for device in _list(found, "inverse3"):
        own_id, kind = _get(device, "device_id"), _get(_get(device, "config"), "type") or "inverse3"
        # A Minverse is listed there too, but is another device with other limits.
        if type(own_id) is str and device_id in (None, own_id) and str(kind).startswith("inverse3"):
            break
    else:
        return None
    place = _get(_get(device, "state"), "cursor_position")
    values = [_get(place, name) for name in "xyz"]
    # Written so that NaN, which compares false with everything, is refused too.
    if not all(type(each) in (float, int) and -FARTHEST_M <= each <= FARTHEST_M for each in values):
        raise PeerError(f"the Haply service sent a cursor_position that is not three numbers within {FARTHEST_M:g} m")
    grips = [_get(each, "state") for name in GRIPS for each in _list(found, name)]
    clutched = any(_get(each, "button") is True or _get(_get(each, "buttons"), button) is True for each in grips)
    return own_id, tuple(map(float, values)), clutched


def _get(found: Any, key: str) -> Any:
    return found.get(key) if type(found) is dict else None


def _list(found: Any, key: str) -> list[Any]:
    values = _get(found, key)
    return values if type(values) is list else []


class HaplyOperator:
    """A hand on an Inverse3. Satisfies `operator.base.Operator`, with `feel`.

    The tool begins at 0. It moves as the device does from the message in which the hand takes it: the first one, the
    first one after a fault, and the first one after the button of the handle. So it never jumps; and the force then
    rises from zero. Meanwhile the tool stays where it is, without a force.
    """

    duration_us = None
    what = "the Inverse3"

    def __init__(self, settings: HaplySettings) -> None:
        self.settings, self.axes = settings, settings.axes
        self.capabilities = Capabilities(
            axes=settings.axes, max_force_n=settings.max_force_n, slew_n_per_s=SLEW_N_PER_S, travel_m=TRAVEL_M,
            grounded=True,
        )  # fmt: skip
        # Counts: states of the device, messages without, and times when the force went to zero by a fault
        self.states = self.malformed = self.faults = 0
        self.device_id: str | None = None  # None: there is no connection, or no such device
        self.fault: str | None = "no state yet"  # why the hand does not hold the tool
        first, sign = "xyz".index(settings.axis[-1]), -1.0 if settings.axis.startswith("-") else 1.0
        # Axis of the device for each of the tool, and direction; both frames are right-handed.
        self._frame = [(first, sign), ((first + 1) % 3, 1.0), ((first + 2) % 3, sign)][: self.axes]
        self._zero_n: Vector = (0.0,) * self.axes
        self._tool_m = self._offset_m = self._force_n = self._applied_n = self._zero_n
        self._held_us: int | None = None  # since when the hand holds the tool
        self._felt, self._felt_us = False, -FELT_US
        self._commanded_us, self._answer_us = 0, 0.0  # last command; mean time [µs] to its answer
        self._key = "vector"
        self._messages: deque[tuple[str, bool]] = deque()
        self._told_us: dict[str, int] = {}

    @property
    def applied_n(self) -> Vector:
        """The force [N] last sent to the device."""
        return self._applied_n

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is at `t_us` [µs]."""
        return new_tuple(PositionSample, (t_us, self._tool_m))

    def feel(self, t_us: int, force_n: Vector) -> None:  # noqa: ARG002 - the clock of the device counts
        """Note the force [N] that the device is to apply."""
        self._force_n, self._felt = force_n, True

    def observe(self, now_us: int) -> None:
        """Note after each tick whether the force was felt in it."""
        if self._felt:
            self._felt, self._felt_us = False, now_us

    def receive(self, data: str | bytes, now_us: int) -> None:
        """Process a message of the service. Never raises; without a valid state the force goes to zero."""
        if self.device_id is not None:
            self._answer_us += 0.01 * (now_us - self._commanded_us - self._answer_us)
            if self._answer_us > SLOW_US:
                self._tell("the Haply service takes more than 2 ms to answer: stiff scenes may swing", now_us)
        try:
            state = read_state(data, self.device_id, self.settings.button)
        except PeerError as error:
            self.malformed += 1
            self.fail(str(error), now_us)
            return
        if state is None:
            self.fail(f"the Haply service has no Inverse3 {self.device_id or ''}".rstrip(), now_us, lost=True)
            return
        self.states += 1
        found_id, position_m, clutched = state
        if self.device_id is None:
            # "session_id" and "vector" are in the documents of 3.5, "values" in programs for 3.1: which services
            # between them take which name is not documented, and a wrong one leaves the force at zero.
            self._key = "vector" if '"session_id"' in str(data) else "values"
            self.device_id = found_id
        if self.fault is not None:
            self.fault = None
            most_n = self.capabilities.max_force_n
            self._tell(f"Inverse3 {self.device_id} holds the tool, at most {most_n:g} N", now_us, warns=False)
        if clutched:
            self._held_us = None
            return
        at_m = [sign * position_m[axis] for axis, sign in self._frame]
        if self._held_us is None:
            self._held_us = now_us
            self._offset_m = tuple([tool - at for tool, at in zip(self._tool_m, at_m, strict=True)])
        self._tool_m = tuple([at + offset for at, offset in zip(at_m, self._offset_m, strict=True)])

    def fail(self, why: str, now_us: int, *, lost: bool = False) -> None:
        """Let go of the tool, with zero force, until the next valid state: if `lost`, of any device."""
        self.faults += self.fault is None
        self.fault, self._held_us = why, None
        self.device_id = None if lost else self.device_id
        self._tell(f"{why}; the force is zero", now_us)

    def command(self, now_us: int) -> str:
        """Return the message with the force to apply from now on."""
        self._applied_n = self._limited(now_us)
        self._commanded_us = now_us
        device_n = [0.0, 0.0, 0.0]
        for (axis, sign), force_n in zip(self._frame, self._applied_n, strict=True):
            device_n[axis] = -sign * force_n  # a positive force pushes the hand back along the axis of the tool
        force = {"x": device_n[0], "y": device_n[1], "z": device_n[2]}
        order = {"device_id": self.device_id, "commands": {"set_cursor_force": {self._key: force}}}
        return json.dumps({"inverse3": [order]})

    def _limited(self, now_us: int) -> Vector:
        """Return the force [N] nearest to the one felt that the limits allow."""
        if self._held_us is None or now_us - self._felt_us >= FELT_US:
            return self._zero_n
        step_us = min(now_us - self._commanded_us, LONGEST_STEP_US)
        share = min((now_us - self._held_us) / RISE_US, 1.0)
        return self.capabilities.limited(self._force_n, self._applied_n, step_us, share)

    def _tell(self, line: str, now_us: int, *, warns: bool = True) -> None:
        if now_us - self._told_us.get(line, -LINES_EVERY_US) >= LINES_EVERY_US:
            self._told_us[line] = now_us
            self._messages.append((line, warns))

    def next_message(self) -> tuple[str, bool] | None:
        """Return the next message for a person, and whether it is a warning; None if there is none."""
        return self._messages.popleft() if self._messages else None

    def report(self) -> dict[str, Any]:
        """Return the report of this operator for JSON."""
        return {name: getattr(self, name) for name in ("device_id", "states", "malformed", "faults")}
