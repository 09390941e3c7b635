"""``hapticnet channel``: run an emulated network as a separate process."""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticnet.cli import options

if TYPE_CHECKING:
    from hapticnet.runtime.relay import Relay


def channel(
    connect: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where the slave listens.")],
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Address for masters.")] = "127.0.0.1:47801",
    forward: Annotated[str, typer.Option(metavar="SPEC", help="Network from master to slave.")] = "perfect",
    feedback: Annotated[str, typer.Option(metavar="SPEC", help="Network from slave to master.")] = "perfect",
    duration: Annotated[float | None, typer.Option(min=0.0, help="Stop after this many seconds.")] = None,
    insecure: options.Insecure = False,
    seed: options.Seed = 0,
    real_time: options.RealTime = True,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Relay datagrams between masters and a slave through an emulated network.

    SPEC is a preset (perfect, lan, wifi, 4g, transatlantic, satellite), or parts such as
    delay=20ms,jitter=normal:5ms,loss=2%, or a preset followed by parts.
    """
    from ipaddress import ip_address

    import numpy as np

    from hapticnet.channel.spec import parse_channel
    from hapticnet.cli.console import Console, check_outputs, deliver
    from hapticnet.errors import SettingsError, UnavailableError
    from hapticnet.runtime.overload import Overload
    from hapticnet.runtime.realtime import OTHER, prefer_realtime, run
    from hapticnet.runtime.relay import run_relay
    from hapticnet.runtime.rescue import Rescue
    from hapticnet.runtime.udp import bound_address, is_loopback, open_toward, parse_host_port
    from hapticnet.runtime.udp import listen as listen_on

    there, back = parse_channel(forward), parse_channel(feedback)
    target = parse_host_port(connect)
    sock = listen_on(parse_host_port(listen, lowest_port=0))
    check_outputs(report)
    console = Console("channel", quiet=quiet, real_time=True)
    try:
        toward, slave = open_toward(target)
        toward.close()
    except UnavailableError as error:
        console.warn(f"{error}; trying again when a master connects")
    else:
        here = is_loopback(slave) or ip_address(slave[0]).is_unspecified  # Linux takes 0.0.0.0 for loopback
        if here and not is_loopback(sock.getsockname()) and not insecure:
            raise SettingsError(
                f"{bound_address(sock)} can be reached from other hosts, and the slave at {target} takes every master"
                " behind this relay for one on its own host, with which open sessions are allowed; listen on 127.0.0.1,"
                " or relay for anyone with --insecure"
            )

    def on_status(relay: "Relay") -> None:
        console.status(f"{relay.clients} client{'s' * (relay.clients != 1)}")

    scheduling = prefer_realtime() if real_time else OTHER
    console.say(f"listening on {bound_address(sock)}, to {target}: {there.describe()}; back: {back.describe()}")
    overload = Overload(scheduling, console.warn)
    rescue = Rescue()
    account = run(
        run_relay(
            sock,
            target,
            forward=there,
            feedback=back,
            rng=np.random.default_rng([seed, 5]),
            duration_s=duration,
            on_status=on_status,
            overload=overload,
            rescue=rescue,
        )
    )
    rescue.done()
    console.finish()
    deliver(
        {"scheduling": scheduling, **account, "overload": overload.report()}, as_json=json, file=report, real_time=True
    )
