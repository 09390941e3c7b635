"""``hapticnet slave``: host the scene and answer masters."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet.cli import options

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.node.slave_events import SlaveEvent
    from hapticnet.runtime.watching import Watcher


def slave(
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where to listen; port 0 takes a free one.")] = (
        "127.0.0.1:47800"
    ),
    scene: options.SceneOption = "paper",
    duration: Annotated[float | None, typer.Option(min=0.0, help="Stop after this many seconds.")] = None,
    key: options.KeyOption = None,
    masters: options.MastersOption = None,
    insecure: options.Insecure = False,
    keep: Annotated[
        float, typer.Option(metavar="SECONDS", help="Keep the scene of a silent master this long for its return.")
    ] = 30.0,
    fastest_rate: Annotated[float, typer.Option(help="Highest sample rate granted to a master [Hz].")] = 10_000.0,
    most_sessions: Annotated[int, typer.Option(min=1, help="Sessions served at once.")] = 64,
    seats: Annotated[
        int, typer.Option(min=1, help="Sessions of one key at once (without keys, of one host), unless the list says.")
    ] = 16,
    announce: Annotated[
        options.Announce,
        typer.Option(
            help="What to tell masters that ask for the contact ahead: what the scene declares, or what was"
            " measured of it."
        ),
    ] = "declared",
    codec: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE.py:CLASS",
            help="Codec of yours that masters may ask for, or package.module:CLASS; repeat for more. Codecs of"
            " installed packages are always served.",
        ),
    ] = None,
    compiled: Annotated[
        bool,
        typer.Option(
            "--compiled",
            help="Serve all usual sessions in one compiled pass, for many masters: codecs raw and deadband, scenes of"
            " springs. Needs the fast extra.",
        ),
    ] = False,
    channel_out: options.ChannelOut = "perfect",
    seed: options.Seed = 0,
    record: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Record each session in DIR/NAME-SESSION and the format's suffix."),
    ] = None,
    record_format: Annotated[options.RecordFormat, typer.Option(help="Format of the recordings.")] = "csv",
    record_limit: options.RecordLimit = options.RECORD_LIMIT,
    stream: options.StreamOption = None,
    metrics: options.MetricsOption = None,
    realtime: options.Realtime = True,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Host the virtual tissues: each master touches its own scene.

    On loopback, anyone is served unless --key or --masters is given. Elsewhere, only the masters of the list are
    served: --key and --masters, by default key.toml and masters.toml in ~/.config/hapticnet.

    Ends on Ctrl-C, SIGTERM or after --duration, and then prints its report.
    """
    import os
    import signal
    from functools import partial

    import numpy as np

    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.spec import parse_channel
    from hapticnet.checks import check_parameter
    from hapticnet.cli.console import Console, channel_account, check_outputs, deliver
    from hapticnet.cli.slave_messages import SlaveMessages, place
    from hapticnet.cli.trust import slave_trust
    from hapticnet.cli.watching import watch_slave
    from hapticnet.codec.registry import parse_codec, register_installed_codecs
    from hapticnet.compiled import fast_extra_installed
    from hapticnet.errors import FileError, SettingsError, UnavailableError
    from hapticnet.experiment.provenance import provenance
    from hapticnet.files import check_folder
    from hapticnet.node.admission import SlaveSettings
    from hapticnet.node.compiled_slave import CompiledSlaveNode
    from hapticnet.node.slave import SlaveNode
    from hapticnet.protocol.handshake import Door, OpenDoor, SealedDoor
    from hapticnet.protocol.keys import MasterEntry
    from hapticnet.protocol.settings import SessionSettings
    from hapticnet.protocol.wire import OPEN, SEALED
    from hapticnet.recordings.session.archive import check_format
    from hapticnet.runtime.clock import now_us
    from hapticnet.runtime.entropy import SystemEntropy
    from hapticnet.runtime.overload import Overload
    from hapticnet.runtime.realtime import OTHER, policy, prefer_realtime, run
    from hapticnet.runtime.session_recordings import SlaveRecording
    from hapticnet.runtime.slave_run import run_slave
    from hapticnet.runtime.udp import bound_address, host_of, is_loopback, parse_host_port
    from hapticnet.runtime.udp import listen as listen_on
    from hapticnet.runtime.udp_batch import SocketAddresses
    from hapticnet.scene.base import Touchable
    from hapticnet.scene.sources import find_source

    console = Console("slave", quiet=quiet, real_time=True)
    for text in codec or ():
        if parse_codec(text)[1]:
            raise SettingsError(f"--codec {text}: omit the parameters; each master sends its own")
    for fault in register_installed_codecs():
        console.warn(f"not served: {fault}")
    check_parameter("--keep", keep, 1.0, 86_400.0, "s")
    source = find_source(scene)
    source.prepare()
    for note in source.notes:
        console.say(f"{source.file}: {note}")
    out = parse_channel(channel_out)
    sock = listen_on(parse_host_port(listen, lowest_port=0))
    address = bound_address(sock)
    loopback = is_loopback(sock.getsockname())
    trust = slave_trust(address, loopback, key, masters, insecure)
    guests, entropy = trust.guests, SystemEntropy()
    doors: dict[int, Door] = {OPEN: OpenDoor()} if trust.serves_open else {}
    if guests is not None:
        doors[SEALED] = SealedDoor(guests.own.private, guests.roster, entropy)

    def make_scene(entry: MasterEntry | None) -> Touchable:
        return (source if guests is None else guests.scene_of(entry, source)).make()

    make_node: Callable[..., SlaveNode] = SlaveNode
    if compiled:
        for option, given in (("--record", record), ("--stream", stream)):
            if given is not None:
                raise SettingsError(f"{option} needs each sample, which --compiled does not keep; omit one of them")
        if not fast_extra_installed():
            raise UnavailableError("--compiled needs numba: pip install 'hapticnet[fast]'")
        console.say("compiling; the first time, this takes a quarter of a minute")
        make_node = partial(CompiledSlaveNode, addresses=SocketAddresses())
    node = make_node(
        make_scene,
        SlaveSettings(
            fastest_rate_hz=fastest_rate,
            announces=announce,
            record=record is not None,
            record_datagrams=record is not None,
            session=SessionSettings(most_sessions=most_sessions, most_per_identity=seats, keep_us=round(keep * 1e6)),
        ),
        entropy,
        doors=doors,
        write_address=place,
        host_of=host_of,
    )
    channel = None if out.is_perfect else Emulator[Any](out, np.random.default_rng([seed, 1]))
    if record is not None:
        check_format(Path(f"session.{record_format}"))
        check_folder(record)
    check_outputs(report, inputs=[source.file, *trust.files])
    watchers: list[Watcher[SlaveEvent]] = [SlaveMessages(console, node, guests)]
    recording = None
    if record is not None:
        about = {"seed": seed, "scene": scene, "channel_out": out.describe(), "provenance": provenance()}
        recording = SlaveRecording(
            node, record, console.warn, suffix=f".{record_format}", limit_bytes=record_limit, about=about
        )
        watchers.append(recording)
    terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]

    def on_hangup() -> None:
        if terminals and not any(os.isatty(descriptor) for descriptor in terminals):  # the terminal was closed
            signal.raise_signal(signal.SIGTERM)
            return
        if guests is None:
            console.warn("this slave has no list of masters to read again")
            return
        try:
            guests.read()
        except (FileError, SettingsError) as error:
            console.warn(f"the list of masters is unchanged: {error}")
            return
        node.serve_only(guests.roster, now_us())
        count = len(guests.roster)
        console.say(f"read {guests.file} again: {count} {'master' if count == 1 else 'masters'}")

    for line in trust.lines():
        console.say(line)
    for line in trust.warnings(loopback):
        console.warn(line)
    scheduling = prefer_realtime() if realtime else OTHER
    overload = Overload(scheduling, console.warn)
    watchers += watch_slave(node, console, overload, stream=stream, metrics=metrics)
    try:
        run(
            run_slave(
                node,
                sock,
                channel=channel,
                duration_s=duration,
                watchers=watchers,
                overload=overload,
                tell=console.warn,
                on_listening=lambda: console.say(f"listening on {address}, scene {source.name}, {policy(scheduling)}"),
                on_hangup=on_hangup,
            )
        )
    finally:
        for fault in (*source.close(), *(() if guests is None else guests.close())):
            console.warn(fault)
    console.finish()
    account: dict[str, Any] = {"scheduling": scheduling, **node.report(), "overload": overload.report()}
    if recording is not None:
        account["recording"] = recording.recorder.report()
    if channel is not None:
        account["channel_out"] = channel_account(out, channel)
    try:
        deliver(account, as_json=json, file=report, real_time=True)
    finally:  # the reader of stdout may have gone
        if recording is not None:
            recording.recorder.check()
