"""A channel as one line of text: a named network, parts, or both.

Each named network describes one direction of a link; a round trip passes through two. Only physical limits are exact.
The other numbers are typical of such links, for trying a system on a kind of network; they are not measurements of one.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from hapticnet.channel.settings import (
    DEFAULT_HOLD_BACK_US,
    ChannelSettings,
    parse_jitter,
    parse_loss,
    parse_rate_bit_per_s,
    parse_share,
    parse_time_us,
)
from hapticnet.errors import SettingsError


def parse_channel(spec: str) -> ChannelSettings:
    """Return the settings written as a preset, as parts separated by commas, or as a preset followed by parts.

    ``perfect``, ``wifi``, ``wifi,loss=5%``, or the parts ``delay=20ms``, ``jitter=normal:5ms`` (or ``uniform:5ms``,
    ``pareto:5ms``), ``loss=2%`` (or ``gilbert:p,r[,h[,k]]``), ``reorder=1%[:10ms]``, ``duplicate=0.1%``,
    ``rate=1Mbit/s``, ``queue=100ms``. A part replaces the preset's; ``none`` removes it. Case does not matter.

    Raise SettingsError if a part is invalid; the message names it and says what is valid.
    """
    parts = spec.lower().split(",")
    settings = ChannelSettings()
    if "=" not in parts[0]:
        preset = parts.pop(0).strip()
        if preset not in PRESETS:
            raise SettingsError(
                f'channel: "{preset[:60]}" is not a preset; presets are {", ".join(PRESETS)}, '
                "or write parts such as delay=20ms,loss=2%"
            )
        settings = PRESETS[preset]
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
    "loss": _part("loss", parse_loss),
    "reorder": _reorder,
    "duplicate": _part("duplicate_probability", parse_share),
    "rate": _part("rate_bit_per_s", parse_rate_bit_per_s),
    "queue": _part("queue_us", parse_time_us),
}
"""The parts of a specification in the order they take effect, each with its change of the settings."""


PRESETS: Final[Mapping[str, ChannelSettings]] = {
    "perfect": _DEFAULTS,
    # A few switches and both hosts' network stacks; the rate is 1000BASE-T's.
    "lan": parse_channel("delay=200us,jitter=normal:50us,rate=1Gbit/s"),
    # A shared home or office access point. Losses come in bursts of 2.5 packets, 1 % overall; two states are a
    # simplification: da Silva and Pedroso, Sensors 22 (2022) 8592, find them inadequate for measured Wi-Fi losses.
    # Order is kept because 802.11 receivers reorder.
    "wifi": parse_channel("delay=2ms,jitter=pareto:3ms,loss=gilbert:0.4%,40%,rate=50Mbit/s"),
    # Rate and delay after Ofcom's measurements with smartphones in five UK towns, Q4 2014: mean upload 13.6 Mbit/s,
    # mean round trip 53.1 ms (20 ms and a jitter of 6.6 ms on average, twice).
    "4g": parse_channel("delay=20ms,jitter=normal:5ms,loss=gilbert:0.1%,50%,rate=13600kbit/s,queue=300ms"),
    # London to New York: light in fibre along the great circle takes 27.3 ms; the fastest cable's tested round trip is
    # 58.95 ms (Hibernia Express, 2015).
    "transatlantic": parse_channel("delay=35ms,jitter=normal:500us,loss=0.1%,rate=100Mbit/s"),
    # Geostationary: 238.7 ms with the satellite overhead at both ends to 278.1 ms on the horizon, plus ground
    # equipment, for the round trip of about 600 ms that Huston reports (APNIC, 2022).
    "satellite": parse_channel("delay=290ms,jitter=normal:8ms,loss=gilbert:0.1%,20%,rate=5Mbit/s,queue=300ms"),
}
"""Named networks, each with the sources of its numbers."""
