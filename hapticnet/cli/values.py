"""The values of options by the parameter's name: what is checked before a verb begins.

Imports happen only once there is a value.
"""

from collections.abc import Mapping
from typing import Any, Final

import typer

from hapticnet.errors import SettingsError

CHECKED: Final = {
    "connect", "listen", "metrics", "page", "channel_out", "channel_in", "codec", "add_codec", "rate", "fastest_rate",
    "device", "operator", "scheduler",
}  # fmt: skip


def check_values(ctx: typer.Context, options: Mapping[str, Any]) -> None:
    """Check the given options of a verb; raise typer.BadParameter, which names the option."""
    parameters: list[Any] = list(ctx.command.params)
    for parameter in parameters:
        source = ctx.get_parameter_source(parameter.name)
        is_default = source is None or source.name == "DEFAULT"
        if is_default or parameter.name not in CHECKED or parameter.param_type_name != "option":
            continue
        value = options[parameter.name]
        for each in value if isinstance(value, list | tuple) else [value]:
            try:
                _check(parameter.name, each)
            except SettingsError as error:
                raise typer.BadParameter(str(error), ctx=ctx, param=parameter) from error


def _check(name: str, value: Any) -> None:
    """Raise SettingsError if a value of the parameter `name` cannot be used."""
    if name in ("connect", "listen", "metrics", "page"):
        from hapticnet.cli.pages import page_address
        from hapticnet.runtime.udp import parse_host_port

        if name == "page":
            page_address(value)
        else:
            parse_host_port(value, lowest_port=int(name == "connect"))
    elif name in ("channel_out", "channel_in"):
        from hapticnet.channel.spec import parse_channel

        parse_channel(value)
    elif name in ("codec", "add_codec"):
        from hapticnet.codec.registry import make_codec, parse_codec
        from hapticnet.perception import WeberLaw

        codec, parameters = parse_codec(value)
        if parameters and name == "add_codec":
            raise SettingsError(f"{value}: omit the parameters; each master sends its own")
        make_codec(codec, WeberLaw(), parameters)
    elif name in ("rate", "fastest_rate"):
        from hapticnet.protocol.messages import RATE_HZ

        RATE_HZ.check(value)
    elif name == "device":
        from hapticnet.runtime.devices import check_device

        if value != "none":
            check_device(value)
    elif name == "operator":
        from hapticnet.cli.operators import check_operator

        check_operator(value)
    elif name == "scheduler":
        kind, separator, place = value.partition("://")
        if kind not in ("tcp", "tls") or not separator:
            raise SettingsError(f"address {value!r} must be tcp://HOST:PORT or tls://HOST:PORT")
        _check("connect", place)
