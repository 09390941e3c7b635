"""Read a channel specification: one line of text with a preset, parts, or both."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from hapticnet.channel.jitter import parse_jitter
from hapticnet.channel.loss import parse_loss
from hapticnet.channel.presets import PRESETS
from hapticnet.channel.quantities import parse_rate_bit_per_s, parse_share, parse_time_us
from hapticnet.channel.settings import DEFAULT_HOLD_BACK_US, ChannelSettings
from hapticnet.errors import SettingsError


def parse_channel(spec: str) -> ChannelSettings:
    """Return the settings written as a preset, as parts separated by commas, or as a preset followed by parts.

    ``perfect``, ``wifi``, ``wifi,loss=5%``, or the parts ``delay=20ms``, ``jitter=normal:5ms`` (or ``uniform:5ms``,
    ``pareto:5ms[:shape]``), ``order=keep`` (or ``free``), ``loss=2%`` (or ``gilbert:p,r[,h[,k]]``,
    ``pattern:0010110``), ``reorder=1%[:10ms]``, ``duplicate=0.1%``, ``rate=1Mbit/s``, ``queue=100ms``. A part
    replaces that of the preset; ``none`` removes it. Case does not matter.

    Raises
    ------
    SettingsError
        If a part is invalid; the message names it and says what is valid.
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
    if name not in PRESETS:
        raise SettingsError(
            f'channel: "{name[:60]}" is not a preset; presets are {", ".join(PRESETS)}, '
            "or write parts such as delay=20ms,loss=2%"
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
"""The parts of a specification in the order they take effect, each with its change of the settings."""
