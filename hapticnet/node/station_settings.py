"""How a slave keeps each of its sessions."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

Announces: TypeAlias = Literal["declared", "measured", "nothing"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StationSettings:
    """How a slave keeps each of its sessions.

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
    """

    record: bool = False
    record_datagrams: bool = False
    on_error: Literal["end", "pause"] = "end"
    announces: Announces = "declared"
