"""``hapticnet gateway``: its options, its token, its addresses, its messages, and its report."""

import asyncio
import base64
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from hapticnet import options
from hapticnet.cli.console import Console, check_outputs, deliver
from hapticnet.cli.pages import say_addresses
from hapticnet.cli.verbs import equip
from hapticnet.errors import RunError, UnavailableError
from hapticnet.options import Option
from hapticnet.protocol.key_files import default_key, is_missing, load_key, write_key
from hapticnet.protocol.keys import new_key
from hapticnet.runtime.nonblocking_log import keep_log
from hapticnet.runtime.signals import stop_on_signals
from hapticnet.runtime.system import SystemEntropy, run
from hapticnet.runtime.udp import is_loopback, listen_for_streams, parse_host_port

if TYPE_CHECKING:
    from hapticnet.web.messages import View
    from hapticnet_gateway.gateway import Gateway

EXAMPLES: Final[dict[tuple[str, ...], tuple[str, ...]]] = {
    ("gateway",): (
        "hapticnet gateway",
        "hapticnet gateway --slave 192.0.2.7:47800 --listen 0.0.0.0:47890 --origin https://touch.example",
    ),
}
"""Examples at the end of ``--help``. A test parses every line."""

Slave: TypeAlias = Annotated[str, Option("The slave that tabs reach; datagrams go to no other address.", "HOST:PORT")]
Origins: TypeAlias = Annotated[
    list[str] | None,
    Option("Let a page served elsewhere connect too, such as https://touch.example; repeatable.", "ORIGIN"),
]
MostTabs: TypeAlias = Annotated[int, Option("Tabs at once.", least=1, most=1000)]
Token: TypeAlias = Annotated[
    Path | None,
    Option("File of the secret that lets tabs connect; made if missing, by default in ~/.config/hapticnet.", "FILE"),
]

app = typer.Typer()


@dataclass(kw_only=True)
class GatewayOptions:
    """The options of ``hapticnet gateway``."""

    slave: Slave = "127.0.0.1:47800"
    listen: options.Listen = "127.0.0.1:47890"
    origin: Origins = None
    token: Token = None
    most_tabs: MostTabs = 8
    duration: options.Duration = None
    json: options.Json = False
    report: options.Report = None
    quiet: options.Quiet = False


@app.command()
def gateway(given: GatewayOptions) -> None:
    """Carry datagrams between browser tabs and a slave, over WebRTC and UDP.

    A tab is the master: hand, codec and keys are in it. The gateway cannot read sealed sessions. It prints the address
    of a page that is such a master.

    Ends on Ctrl-C, SIGTERM or after --duration, and then prints its report.
    """
    keep_log()
    carry(given)


equip(app, (), EXAMPLES)


def carry(given: GatewayOptions) -> None:
    """Carry datagrams until the end, and deliver the report."""
    try:
        from hapticnet_gateway.gateway import Gateway, TabAccess, check_origin, check_slave
    except ModuleNotFoundError as error:
        raise UnavailableError(
            f"hapticnet gateway needs aiohttp and aiortc: pip install aiohttp aiortc ({error})"
        ) from error

    console = Console("gateway", quiet=given.quiet, real_time=True)
    origins = frozenset(map(check_origin, given.origin or ()))
    slave = check_slave(parse_host_port(given.slave))
    address = parse_host_port(given.listen, lowest_port=0)
    token_file = given.token or default_key().with_name("gateway.toml")
    check_outputs(given.report, inputs=[token_file])
    tokens: dict[View, str] = {"operator": read_token(token_file)}
    sock = listen_for_streams(address, f"cannot listen at {address}")
    host, port = sock.getsockname()[:2]
    names = frozenset(origin.partition("://")[2].partition(":")[0] for origin in origins)
    access = TabAccess(address.host if host not in ("0.0.0.0", "::") else socket.gethostname(), port, tokens, names)  # noqa: S104
    gateway = Gateway(slave, access, sock, origins, given.most_tabs, console.say, console.warn)
    exposed = not is_loopback(sock.getsockname())
    if exposed:
        console.warn(
            "other hosts can reach this gateway, and its page is not encrypted: put a proxy with TLS before it"
        )
    if exposed and is_loopback((slave.host, slave.port)):
        console.warn("the slave must use keys (--key or --masters): on loopback it serves anyone otherwise")
    console.say(f"carrying datagrams to {slave}")
    if gateway.has_page:
        say_addresses({"page: ": "operator"}, access, console)
    else:
        console.warn(f"there is no page here ('make tab' builds it); tabs send offers to http://{host}:{port}/offer")
    run(serve(gateway, given.duration, console))
    console.finish()
    deliver(gateway.report(), as_json=given.json, file=given.report, real_time=True)
    if gateway.faults:
        raise RunError("; ".join(gateway.faults))


async def serve(gateway: "Gateway", duration_s: float | None, console: Console) -> None:
    """Run a gateway until a signal, or for `duration_s`."""
    loop = asyncio.get_running_loop()
    stop = stop_on_signals(loop)
    if duration_s is not None:
        loop.call_later(duration_s, stop.set)
    await gateway.run(stop, console.status)


def read_token(path: Path) -> str:
    """Return the token in a file that only its owner can read, and make it if it is missing. Raises like `load_key`."""
    if is_missing(path):
        write_key(path, new_key(SystemEntropy()))
    return base64.urlsafe_b64encode(load_key(path).private).decode().rstrip("=")
