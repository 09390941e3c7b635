"""What a channel does to the packets sent through it, and how that is written in one line of text."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from hapticnet.channel.jitter import Jitter, parse_jitter
from hapticnet.channel.loss import Loss, parse_loss
from hapticnet.channel.quantities import (
    FASTEST_BIT_PER_S,
    LONGEST_US,
    format_rate,
    format_share,
    format_time,
    parse_rate_bit_per_s,
    parse_share,
    parse_time_us,
)
from hapticnet.errors import SettingsError

DEFAULT_HOLD_BACK_US: Final = 10_000
"""How long a reordered packet is held back: ten packets of a 1 kHz stream overtake it."""

DEFAULT_QUEUE_US: Final = 100_000
"""How long a packet may wait for the bottleneck."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelSettings:
    """What one direction of a network does; by default nothing.

    A packet meets the parts in this order: loss, duplication, bottleneck, delay with jitter and reordering. A lost
    packet is not duplicated; a duplicate follows its original through the bottleneck, as a retransmission whose
    acknowledgement was lost does, so that no more than the rate ever leaves it.

    Packets keep their order: none is delivered before one sent earlier. Only two settings lift that rule:
    `reorder_probability`, for single packets, which are held back while later ones overtake; and a jitter that does
    not keep the order, for all.

    Attributes
    ----------
    delay_us
        Shortest time from sending to delivery [µs].
    jitter
        Random delay on top of it.
    loss
        Which packets are lost.
    reorder_probability
        Probability that a packet is held back, 0 to 1.
    hold_back_us
        For how long [µs], beyond its own time of delivery.
    duplicate_probability
        Probability that a packet arrives twice, 0 to 1.
    rate_bit_per_s
        Rate of the bottleneck [bit/s], UDP and IPv4 headers counted; None for no bottleneck.
    queue_us
        Longest time a packet waits for the bottleneck [µs]; one that would wait longer is dropped. The bound is a
        time, for that is what a queue costs a haptic loop, whatever its packets' size and the rate.

    Raises
    ------
    SettingsError
        When a value is out of range.
    """

    delay_us: int = 0
    jitter: Jitter | None = None
    loss: Loss | None = None
    reorder_probability: float = 0.0
    hold_back_us: int = DEFAULT_HOLD_BACK_US
    duplicate_probability: float = 0.0
    rate_bit_per_s: int | None = None
    queue_us: int = DEFAULT_QUEUE_US

    def __post_init__(self) -> None:
        rate = FASTEST_BIT_PER_S if self.rate_bit_per_s is None else self.rate_bit_per_s
        for name, value, least, most in (
            ("delay_us", self.delay_us, 0, LONGEST_US),
            ("reorder_probability", self.reorder_probability, 0, 1),
            ("hold_back_us", self.hold_back_us, 1, LONGEST_US),
            ("duplicate_probability", self.duplicate_probability, 0, 1),
            ("rate_bit_per_s", rate, 1, FASTEST_BIT_PER_S),
            ("queue_us", self.queue_us, 1, LONGEST_US),
        ):
            # Written so that NaN, which compares false with everything, is refused too.
            if not least <= value <= most:
                raise SettingsError(f"channel {name} is {value}; it must be between {least} and {most}")

    @property
    def is_perfect(self) -> bool:
        """Whether every packet is delivered once, in order, at the time it is sent."""
        return (
            self.delay_us == 0
            and (self.jitter is None or self.jitter.deviation_us == 0)
            and (self.loss is None or self.loss.mean == 0.0)
            and self.reorder_probability == 0.0
            and self.duplicate_probability == 0.0
            and self.rate_bit_per_s is None
        )

    def describe(self) -> str:
        """Return the settings as one line that `parse_channel` reads back."""
        parts = []
        if self.delay_us:
            parts.append(f"delay={format_time(self.delay_us)}")
        if self.jitter is not None:
            parts.append(f"jitter={self.jitter.describe()}")
            if not self.jitter.keeps_order:
                parts.append("order=free")
        if self.loss is not None:
            parts.append(f"loss={self.loss.describe()}")
        if self.reorder_probability or self.hold_back_us != DEFAULT_HOLD_BACK_US:
            hold_back = format_time(self.hold_back_us)
            parts.append(f"reorder={format_share(self.reorder_probability)}:{hold_back}")
        if self.duplicate_probability:
            parts.append(f"duplicate={format_share(self.duplicate_probability)}")
        if self.rate_bit_per_s is not None:
            parts.append(f"rate={format_rate(self.rate_bit_per_s)}")
        if self.queue_us != DEFAULT_QUEUE_US:
            parts.append(f"queue={format_time(self.queue_us)}")
        return ",".join(parts) or "perfect"


def parse_channel(spec: str) -> ChannelSettings:
    """Return the settings written as a preset, as parts separated by commas, or as a preset and then parts.

    ``perfect``, ``wifi``, ``wifi,loss=5%``, or the parts ``delay=20ms``, ``jitter=normal:5ms`` (or ``uniform:5ms``,
    ``pareto:5ms[:shape]``), ``order=keep`` (or ``free``), ``loss=2%`` (or ``gilbert:p,r[,h[,k]]``,
    ``pattern:0010110``), ``reorder=1%[:10ms]``, ``duplicate=0.1%``, ``rate=1Mbit/s``, ``queue=100ms``. A part
    replaces what the preset says; ``none`` takes it out. Capitals do not matter.

    Raises
    ------
    SettingsError
        When a part cannot be used; the message names it, and says what can.
    """
    parts = spec.lower().split(",")
    settings = ChannelSettings()
    if "=" not in parts[0]:
        settings = _preset(parts.pop(0).strip())
    values: dict[str, str] = {}
    key = ""
    for part in parts:
        name, equals, value = (text.strip() for text in part.partition("="))
        if not equals and values.get(key, "").startswith("gilbert:"):
            values[key] += f",{name}"
            continue
        key = name
        if not equals or key not in _PARTS:
            raise SettingsError(f'channel: "{part[:60]}" is not a part such as loss=2%; parts are {", ".join(_PARTS)}')
        if key in values:
            raise SettingsError(f'channel: "{key}" is given twice, as {values[key][:60]} and {value[:60]}')
        values[key] = value
    for key, change in _PARTS.items():
        if key in values:
            try:
                settings = replace(settings, **change(settings, values[key]))
            except SettingsError as error:
                raise SettingsError(f"channel: {key}={values[key][:60]}: {error}") from error
    return settings


def _preset(name: str) -> ChannelSettings:
    from hapticnet.channel.presets import PRESETS  # Here, for presets are made of settings.

    if name not in PRESETS:
        raise SettingsError(
            f'channel: "{name[:60]}" is no preset; presets are {", ".join(PRESETS)}, '
            "and anything else is written such as delay=20ms,loss=2%"
        )
    return PRESETS[name].settings


def _order(settings: ChannelSettings, text: str) -> dict[str, Any]:
    if text not in ("keep", "free"):
        raise SettingsError(f'"{text}" is neither keep nor free')
    if settings.jitter is None:
        raise SettingsError("there is no jitter to change the order of packets; add one such as jitter=normal:5ms")
    return {"jitter": replace(settings.jitter, keeps_order=text == "keep")}


def _reorder(_settings: ChannelSettings, text: str) -> dict[str, Any]:
    share, colon, hold_back = text.partition(":")
    return {
        "reorder_probability": 0.0 if text == "none" else parse_share(share),
        "hold_back_us": parse_time_us(hold_back) if colon else DEFAULT_HOLD_BACK_US,
    }


def _part(field: str, parse: Callable[[str], Any]) -> Callable[[ChannelSettings, str], dict[str, Any]]:
    return lambda _settings, text: {field: getattr(_DEFAULTS, field) if text == "none" else parse(text)}


_DEFAULTS: Final = ChannelSettings()

_PARTS: Final[Mapping[str, Callable[[ChannelSettings, str], dict[str, Any]]]] = {
    "delay": _part("delay_us", parse_time_us),
    "jitter": _part("jitter", parse_jitter),
    "order": _order,
    "loss": _part("loss", parse_loss),
    "reorder": _reorder,
    "duplicate": _part("duplicate_probability", parse_share),
    "rate": _part("rate_bit_per_s", parse_rate_bit_per_s),
    "queue": _part("queue_us", parse_time_us),
}
"""The parts of a specification in the order they take effect: how each changes the settings."""
