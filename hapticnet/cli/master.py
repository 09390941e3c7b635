"""``hapticnet master``: the operator's side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from hapticnet.cli import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

ADVISE_AFTER: Final = 6
"""Status intervals without a session after which the operator is told what to check: 3 s."""

if TYPE_CHECKING:
    from hapticnet.node.master import MasterNode, NodeEvent
    from hapticnet.operator.base import Operator
    from hapticnet.protocol.messages import Code


def master(
    connect: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where the slave listens.")] = "127.0.0.1:47800",
    key: options.KeyOption = None,
    peer_key: options.PeerKeyOption = None,
    insecure: options.Insecure = False,
    operator: Annotated[
        str, typer.Option(help="Source of positions: scripted, or a recording as trace:FILE or trace:FILE:COLUMN,….")
    ] = "scripted",
    insertions: Annotated[int, typer.Option(min=1, help="Insertions of the scripted operator.")] = 5,
    device: options.DeviceOption = "sim",
    profile: options.ProfileOption = None,
    duration: Annotated[
        float | None,
        typer.Option(min=0.0, help="Stop this many seconds after connecting; else when the operator is done."),
    ] = None,
    codec: options.Codec = "deadband",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    multiplier: options.Multiplier = 1.0,
    rate: Annotated[float, typer.Option(help="Positions a second.")] = 1000.0,
    name: Annotated[str, typer.Option(help="What the slave's report calls this master.")] = "master",
    max_age: Annotated[
        float,
        typer.Option(metavar="SECONDS", help="Drop forces that answer a position older than this, by the own clock."),
    ] = 1.0,
    channel_out: options.ChannelOut = "perfect",
    seed: options.Seed = 0,
    connect_timeout: Annotated[
        float | None, typer.Option(min=0.0, help="Give up when no slave answers for this many seconds.")
    ] = None,
    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Write every tick to FILE as CSV.")] = None,
    record_limit: options.RecordLimit = options.RECORD_LIMIT,
    realtime: options.Realtime = True,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Stream the operator's position to a slave and drive the fingertip device with the force that comes back.

    Sessions with other hosts need --peer-key, and --key or ~/.config/hapticnet/key.toml.

    Waits for the slave when it is not there yet, and again when it goes away. Ends on Ctrl-C, SIGTERM or when the
    operator is done, and then prints its report.
    """
    from contextlib import nullcontext
    from dataclasses import asdict

    import numpy as np

    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.spec import parse_channel
    from hapticnet.checks import check_parameter
    from hapticnet.cli import devices
    from hapticnet.cli.console import Console, channel_account, check_outputs, deliver
    from hapticnet.cli.key import default_key
    from hapticnet.cli.trust import master_key, refusal_advice, silence_advice
    from hapticnet.codec.registry import parse_codec
    from hapticnet.errors import RefusedError, UnavailableError
    from hapticnet.node.master import MasterNode, MasterSettings, NodeEvent
    from hapticnet.perception import WeberLaw
    from hapticnet.protocol.events import Connected, Ended, Hinted
    from hapticnet.protocol.settings import SessionSettings
    from hapticnet.runtime.entropy import SystemEntropy
    from hapticnet.runtime.overload import Overload, signs
    from hapticnet.runtime.processes import run_master
    from hapticnet.runtime.realtime import OTHER, policy, prefer_realtime, run
    from hapticnet.runtime.recorder import Recorder
    from hapticnet.runtime.udp import is_loopback, open_toward, parse_host_port

    law = WeberLaw(weber_fraction=weber, floor_n=floor, multiplier=multiplier)
    check_parameter("--max-age", max_age, 0.01, 60.0, "s")
    known = devices.load(profile)
    address = parse_host_port(connect)
    sock, slave = open_toward(address)
    keys = master_key(address, is_loopback(slave), key, peer_key, insecure)
    codec_name, parameters = parse_codec(codec)
    settings = MasterSettings(
        codec=codec_name,
        parameters=parameters,
        law=law,
        rate_hz=rate,
        name=name,
        key=keys,
        session=SessionSettings(max_age_us=round(max_age * 1e6)),
        record=record is not None,
        control=devices.control_settings(known),
    )
    hand = _operator(operator, insertions, seed)
    trace = _trace(operator)[0] if operator.startswith("trace:") else None
    out = parse_channel(channel_out)
    channel = None if out.is_perfect else Emulator[Any](out, np.random.default_rng([seed, 2]))
    if duration is None and hand.duration_us is not None:
        duration = hand.duration_us / 1e6
    check_outputs(record, report, inputs=[profile, trace, None if keys is None else key or default_key()])
    console = Console(name, quiet=quiet, real_time=True)
    recorder = Recorder(console.say, limit_bytes=record_limit) if record is not None else None

    def collect() -> None:
        if record is not None and recorder is not None and node.recording is not None:
            recorder.collect(node.recording, record)

    scheduling = prefer_realtime() if realtime else OTHER
    kind = "an open session" if keys is None else "a sealed session"
    console.say(f"asking {address} for {kind}, {codec}, {rate:g} Hz, device {device}, {policy(scheduling)}")
    overload = Overload(scheduling, console.say)
    refusal: Code | None = None
    hint: str | None = None
    intervals = 0

    def on_event(event: NodeEvent) -> None:
        nonlocal refusal, hint, intervals
        if isinstance(event, Connected):
            intervals = ADVISE_AFTER
        elif isinstance(event, Ended) and event.refused:
            refusal = event.code
        elif isinstance(event, Hinted):
            hint = event.reason
        console.say(_in_words(event, str(address)))

    def on_status() -> None:
        nonlocal intervals
        intervals += 1
        if intervals == ADVISE_AFTER:
            advice = silence_advice(keys, node.session.received.malformed, hint)
            console.say(f"no session with {address} yet: {advice}")
        console.status(_status(node))
        collect()

    with (
        nullcontext((None, None)) if device == "none" else devices.real_time_device(device, known, seed) as (
            fingertip,
            wire,
        )
    ):
        if wire and known.is_generic and device.startswith("serial:"):
            console.say(devices.NOT_CALIBRATED)
        node = MasterNode(hand, fingertip, settings, SystemEntropy())
        outcome = run(
            run_master(
                node,
                sock,
                slave,
                wire=wire,
                channel=channel,
                duration_s=duration,
                connect_timeout_s=connect_timeout,
                on_event=on_event,
                on_status=on_status,
                overload=overload,
            )
        )
    console.finish()
    collect()
    busy = signs(overload.report())
    if busy:
        console.say(f"this machine was too busy for {rate:g} Hz: {'; '.join(busy)}")
    account = {"scheduling": scheduling, **node.report(), **asdict(outcome), "overload": overload.report()}
    if recorder is not None:
        account["recording"] = recorder.report()
    if channel is not None:
        account["channel_out"] = channel_account(out, channel)
    try:
        deliver(account, as_json=json, file=report, real_time=True)
    finally:  # the reader of stdout may have gone
        if recorder is not None:
            recorder.finish()
    if node.refused:
        raise RefusedError(f"{address} refused the session: {node.end_reason}{refusal_advice(keys, refusal)}")
    if node.failure is not None:
        raise UnavailableError(node.failure)
    if not outcome.connected and connect_timeout is not None:
        advice = silence_advice(keys, node.session.received.malformed, hint)
        if outcome.strangers:
            advice = "datagrams came from another address: name the one it answers from"
        raise UnavailableError(f"no session with {address} within {connect_timeout:g} s: {advice}")


def _operator(spec: str, insertions: int, seed: int) -> "Operator":
    import numpy as np

    from hapticnet.cli.console import Console
    from hapticnet.errors import SettingsError
    from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
    from hapticnet.operator.trace import load_trace

    if spec == "scripted":
        return ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng([seed, 3]))
    if spec.startswith("trace:") and spec != "trace:":
        file, columns = _trace(spec)
        operator, notes = load_trace(file, position=columns)
        for note in notes:
            Console("master").say(f"{file}: {note}")
        return operator
    raise SettingsError(f"unknown operator {spec!r}; there are: scripted, trace:FILE[:COLUMN,…]")


def _trace(spec: str) -> tuple[Path, str | None]:
    """Return file and columns of trace:FILE[:COLUMN,…]; a file may have a colon in its name."""
    whole = spec.removeprefix("trace:")
    file, colon, columns = whole.rpartition(":")
    return (Path(file), columns) if colon and not Path(whole).exists() else (Path(whole), None)


def _in_words(event: "NodeEvent", address: str) -> str:
    from hapticnet.node.fingertip import DeviceFound, DeviceLost, ForceFault
    from hapticnet.node.master import Failed
    from hapticnet.protocol.events import Connected, Hinted, LinkRecovered, LinkStale, Refused, SessionLost

    if isinstance(event, Connected):
        grant = event.grant
        resumed = ", as it was left" if grant.resumed else ""
        return f"connected to {address}, scene {grant.scene}{resumed}, {grant.rate_hz:g} Hz granted"
    if isinstance(event, LinkStale):
        if event.too_old_us is not None:
            return (
                f"link too slow: forces answer positions {event.too_old_us / 1e6:.2f} s old, which is above --max-age;"
                " the held force decays to zero"
            )
        return "link stale: nothing arrived from the slave; the held force decays to zero"
    if isinstance(event, LinkRecovered):
        return "link recovered"
    if isinstance(event, SessionLost):
        return f"session lost ({event.reason}); asking for a new one"
    if isinstance(event, Refused):
        return f"the slave refuses a new session ({event.reason}); asking again in {event.retry_us / 1e6:g} s"
    if isinstance(event, Hinted):
        return f"unauthenticated refusal ({event.reason}); asking again"
    if isinstance(event, DeviceFound):
        return f"device ready: {event.description}"
    if isinstance(event, DeviceLost):
        return f"device lost ({event.reason}); the session goes on, the finger feels nothing"
    if isinstance(event, Failed):
        return f"{event.reason}; the force goes to zero and the session is closed"
    if isinstance(event, ForceFault):
        return f"platform retracted: {event.reason}"
    return f"session ended: {event.reason}"


def _status(node: "MasterNode") -> str:
    from hapticnet.runtime.clock import now_us

    session = node.session
    round_trip_us = session.round_trip.percentile(50)
    return (
        f"{session.state.value}, holding {node.held_force_n(now_us()):.2f} N, {session.sent.packets} packets out,"
        f" {session.received.packets} in, {session.received.lost} lost"
        + (f", round trip {round_trip_us / 1000:.2f} ms" if round_trip_us else "")
    )
