"""What is checked of the values of options before a verb begins; imports wait until there is a value."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import typer

from hapticnet.errors import SettingsError


def address(text: str) -> None:
    """Check the address of another process."""
    from hapticnet.runtime.udp import parse_host_port

    parse_host_port(text)


def own_address(text: str) -> None:
    """Check an address to listen on."""
    from hapticnet.runtime.udp import parse_host_port

    parse_host_port(text, lowest_port=0)


def page(text: str) -> None:
    """Check the address of the live page."""
    from hapticnet.cli.pages import page_address

    page_address(text)


def network(text: str) -> None:
    """Check an emulated network."""
    from hapticnet.channel.spec import parse_channel

    parse_channel(text)


def codec(text: str) -> None:
    """Check a codec with its parameters."""
    from hapticnet.codec.registry import make_codec, parse_codec
    from hapticnet.perception import WeberLaw

    name, parameters = parse_codec(text)
    make_codec(name, WeberLaw(), parameters)


def rate(value: float) -> None:
    """Check the positions a second."""
    from hapticnet.protocol.messages import RATE_HZ

    RATE_HZ.check(value)


def served_codec(text: str) -> None:
    """Check a codec that a slave is to serve, whose parameters come from the masters."""
    from hapticnet.codec.registry import parse_codec

    if parse_codec(text)[1]:
        raise SettingsError(f"{text}: omit the parameters; each master sends its own")
    codec(text)


def device(text: str) -> None:
    """Check a device."""
    from hapticnet.runtime.devices import check_device

    if text != "none":
        check_device(text)


def operator(text: str) -> None:
    """Check the kind of operator."""
    from hapticnet.cli.operators import check_operator

    check_operator(text)


def scheduler(text: str) -> None:
    """Check the address of a Dask scheduler."""
    kind, separator, place = text.partition("://")
    if kind not in ("tcp", "tls") or not separator:
        raise SettingsError(f"address {text!r} must be tcp://HOST:PORT or tls://HOST:PORT")
    address(place)


CHECKS: Final[dict[str, Callable[[Any], None]]] = {  # checks by the name of the parameter
    "connect": address,
    "listen": own_address,
    "metrics": own_address,
    "page": page,
    "channel_out": network,
    "channel_in": network,
    "codec": codec,
    "rate": rate,
    "fastest_rate": rate,
    "add_codec": served_codec,
    "device": device,
    "operator": operator,
    "scheduler": scheduler,
}


def check_values(ctx: typer.Context, options: Mapping[str, Any]) -> None:
    """Check what was given of the options of a verb.

    Raise typer.BadParameter if a value cannot be used; it names the option.
    """
    parameters: list[Any] = list(ctx.command.params)
    for parameter in parameters:
        source = ctx.get_parameter_source(parameter.name)
        is_default = source is None or source.name == "DEFAULT"
        if is_default or parameter.name not in CHECKS or parameter.param_type_name != "option":
            continue
        value = options[parameter.name]
        for text in value if isinstance(value, list | tuple) else [value]:
            try:
                CHECKS[parameter.name](text)
            except SettingsError as error:
                raise typer.BadParameter(str(error), ctx=ctx, param=parameter) from error
