"""Settings of a master (its request, and how it applies forces) and of a slave (its grants and sessions)."""

from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters
from hapticnet.control.couplings import parse_coupling
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import HoldSettings
from hapticnet.control.ports import TwoPort
from hapticnet.errors import SettingsError
from hapticnet.operator.mapping import Mapping
from hapticnet.parts import law_numbers, parts_request
from hapticnet.perception import WeberLaw
from hapticnet.protocol.keys import MasterKey, check_name
from hapticnet.protocol.messages import POSITION_SHARE, RATE_HZ, VIBRATION_BUDGET, VIBRATION_THRESHOLD, Request
from hapticnet.protocol.settings import SessionSettings

OnError: TypeAlias = Literal["end", "pause"]

Positions: TypeAlias = Literal["raw", "line"]

DeviceTakes: TypeAlias = Literal["x", "y", "z", "norm"]  # the part of the force that a device with one axis renders
LEAST_AGE_ON_A_LINE_US: Final = 200_000
"""Smallest `max_age_us` with positions that are only sent when they matter: the position behind an answer may be 150 ms
older than the time it answers, so that with a shorter limit no answer would be fresh."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterSettings:
    """A master's request, and how it applies the forces it receives."""

    # the feedback codec, its own parameters, and the JND of the person at this master
    codec: str = "deadband"
    parameters: dict[str, float] = field(default_factory=dict)
    law: WeberLaw = field(default_factory=WeberLaw)
    # Weber fraction and smallest threshold of other kinds of parts than force, instead of the published (`parts.KINDS`)
    part_laws: dict[str, tuple[float, float]] = field(default_factory=dict)
    rate_hz: float = 1000.0  # positions per second to ask for; the slave may grant less
    # which positions to send: "raw", every one; "line", those that matter, each with a velocity. A slave whose scene
    # cannot be stepped in between grants "raw".
    positions: Positions = "raw"
    position_share: float = 0.25  # with "line": share of the JND for positions, 0.01 to 0.9
    name: str = "master"  # name of this master in the slave's report
    key: MasterKey | None = None  # this master's key and the slave's public key; None for an open session
    record: bool = False  # whether every tick is recorded
    record_datagrams: bool = False  # whether every datagram is recorded
    # effect of an operator's exception: end the session, or pause until `MasterNode.resume`. The force goes to
    # zero in either case. An exception of the codec or the device always ends the session.
    on_error: OnError = "end"
    device_takes: DeviceTakes = "x"  # the axis of the force that the device renders, or its norm
    announced: bool = False  # whether to ask for models of the contact ahead, and render them at its own position
    predicted: bool = False  # whether to ask for forces where the hand will be when they arrive
    # whether to ask for vibration beside force, with at most so many bytes per second of UDP payload, and the amplitude
    # [m/s²] of the weakest that this person feels
    vibration: bool = False
    vibration_budget: float = 6000.0
    vibration_threshold: float = 0.1
    mapping: Mapping = field(default_factory=Mapping)  # between the hand and the scene
    coupling: str = "direct"  # how to keep a hand that yields from oscillating: NAME[:KEY=VALUE,…]
    first_touch: bool = False  # whether to find the finger before asking for a session
    session: SessionSettings = field(default_factory=SessionSettings)
    hold: HoldSettings = field(default_factory=HoldSettings)
    control: ForceControlSettings = field(default_factory=ForceControlSettings)

    def __post_init__(self) -> None:
        check_name(self.name)
        if self.positions not in ("raw", "line"):
            raise SettingsError(f"positions is {self.positions!r}; it must be 'raw' or 'line'")
        POSITION_SHARE._replace(name="position_share", zero_allowed=False).check(self.position_share)
        if self.positions == "line" and self.session.max_age_us < LEAST_AGE_ON_A_LINE_US:
            raise SettingsError(
                f"the largest age is {self.session.max_age_us / 1e6:g} s; with positions that are only sent when they"
                f" matter it must be at least {LEAST_AGE_ON_A_LINE_US / 1e6:g} s, because they are up to 0.15 s old"
            )
        RATE_HZ.check(self.rate_hz)
        VIBRATION_BUDGET.check(self.vibration_budget)
        VIBRATION_THRESHOLD.check(self.vibration_threshold)
        if not isinstance(self.coupling, str):
            raise SettingsError(f"coupling is {self.coupling!r}; it must be text, such as 'energy-bounded'")
        every_position = self.positions != "line" and not self.announced and not self.predicted
        if isinstance(parse_coupling(self.coupling), TwoPort) and not every_position:
            raise SettingsError(
                f"coupling {self.coupling!r} answers each position at the slave; it cannot be combined with"
                " positions 'line', announced or predicted"
            )

    def request(self, codec: Codec, axes: int, coupling: tuple[str, dict[str, float]] | None) -> Request:
        """Return what to ask the slave for, with a codec and a coupling in which it takes part, if any."""
        return Request(
            codec=codec.name,
            parameters=codec_parameters(codec),
            **law_numbers(codec.law),
            rate_hz=self.rate_hz,
            axes=axes,
            position_share=self.position_share if self.positions == "line" else 0.0,
            name=self.name,
            announced=self.announced,
            predicted=self.predicted,
            coupling=coupling,
            parts=parts_request(codec.law),
            vibration=(self.vibration_budget, self.vibration_threshold) if self.vibration else None,
        )


def device_axes(takes: DeviceTakes, axes: int, device_has: int) -> tuple[int, ...] | None:
    """Return the axes of a force that a device renders; None: the norm. With one axis, it renders what it `takes`."""
    if device_has > 1 and axes > 1:
        return tuple(range(min(device_has, axes)))
    if takes == "norm":
        return None
    axis = "xyz".index(takes)
    if axis >= axes:
        of = "one axis" if axes == 1 else f"{axes} axes"
        raise SettingsError(f"the device is to render the force along {takes}, but positions have {of}")
    return (axis,)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveSettings:
    """A slave's grants, and how it keeps its sessions."""

    record: bool = False  # whether every sample is recorded
    record_datagrams: bool = False  # whether every datagram is recorded
    on_error: Literal["end", "pause"] = "end"  # at an exception of the scene: end, or zero force until `resume`
    announces: bool = True  # whether masters that ask for it are told of the contact ahead
    fastest_rate_hz: float = 10_000.0  # highest sample rate granted to a master [Hz]
    session: SessionSettings = field(default_factory=SessionSettings)

    def __post_init__(self) -> None:
        RATE_HZ._replace(name="fastest rate").check(self.fastest_rate_hz)
