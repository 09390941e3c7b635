"""What a slave grants, and how it keeps each of its sessions."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from hapticnet.protocol.ranges import RATE_HZ
from hapticnet.protocol.settings import SessionSettings

Announces: TypeAlias = Literal["declared", "measured", "nothing"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveSettings:
    """What a slave grants, and how it keeps each of its sessions.

    Attributes
    ----------
    record
        Whether every sample is recorded.
    record_datagrams
        Whether every datagram is recorded.
    on_error
        What an exception of the scene does: end the session, or answer with zero force until `resume`.
    announces
        What masters that ask for it are told of the contact ahead: what the scene declares, what `MeasuredScene`
        learns of it, or nothing.
    fastest_rate_hz
        Highest sample rate granted to a master [Hz].
    """

    record: bool = False
    record_datagrams: bool = False
    on_error: Literal["end", "pause"] = "end"
    announces: Announces = "declared"
    fastest_rate_hz: float = 10_000.0
    session: SessionSettings = field(default_factory=SessionSettings)

    def __post_init__(self) -> None:
        RATE_HZ._replace(name="fastest rate").check(self.fastest_rate_hz)
