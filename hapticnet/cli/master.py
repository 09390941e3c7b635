"""``hapticnet master``: the operator's side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from hapticnet.cli import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

if TYPE_CHECKING:
    from hapticnet.node.master_events import NodeEvent
    from hapticnet.runtime.watching import Watcher


INSERTIONS: Final = 5
POSITION_SHARE: Final = 0.25


def master(
    connect: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where the slave listens.")] = "127.0.0.1:47800",
    key: options.KeyOption = None,
    peer_key: options.PeerKeyOption = None,
    insecure: options.Insecure = False,
    operator: options.OperatorOption = None,
    insertions: Annotated[
        int, typer.Option(min=1, help="Insertions or palpations of the scripted operator.")
    ] = INSERTIONS,
    device: options.DeviceOption = "sim",
    profile: options.ProfileOption = None,
    duration: Annotated[
        float | None,
        typer.Option(min=0.0, help="Stop this many seconds after connecting; else when the operator is done."),
    ] = None,
    codec: options.Codec = "deadband",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    law: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="The law that 'experiment limits' measured, in place of --weber and --floor."
        ),
    ] = None,
    multiplier: options.Multiplier = 1.0,
    rate: Annotated[float, typer.Option(help="Positions a second.")] = 1000.0,
    name: Annotated[str, typer.Option(help="What the slave's report calls this master.")] = "master",
    max_age: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", help="Ignore forces that answer a position older than this, by the master's clock."
        ),
    ] = 1.0,
    channel_out: options.ChannelOut = "perfect",
    channel_in: options.ChannelIn = "perfect",
    page: options.PageOption = None,
    device_takes: Annotated[
        options.DeviceTakes, typer.Option(help="The part of a force of several axes that the device renders.")
    ] = "x",
    announced: Annotated[
        bool, typer.Option(help="Ask the slave to announce the contact ahead, and render it without delay.")
    ] = False,
    positions: Annotated[
        options.Positions,
        typer.Option(help="Which positions to send: every one (raw), or those that matter, with a velocity (line)."),
    ] = "raw",
    position_share: Annotated[
        float, typer.Option(help="With --positions line: the share of the JND that positions may use.")
    ] = POSITION_SHARE,
    passive: Annotated[
        bool, typer.Option(help="Damp a force that would return more energy than the hand put in.")
    ] = False,
    first_touch: Annotated[
        bool,
        typer.Option(help="Find the finger with a press of 1 N before asking for a session."),
    ] = False,
    seed: options.Seed = 0,
    connect_timeout: Annotated[
        float | None, typer.Option(min=0.0, help="Give up when no slave answers for this many seconds.")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Record every tick, datagram and event in FILE: .mcap, .csv or .npz."),
    ] = None,
    record_limit: options.RecordLimit = options.RECORD_LIMIT,
    metrics: options.MetricsOption = None,
    real_time: options.RealTime = True,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Stream the operator's position to a slave and drive the fingertip device with the force that comes back.

    Sessions with other hosts need --peer-key, and --key or ~/.config/hapticnet/key.toml.

    Waits for the slave when it is not there yet, and again when it goes away. Ends on Ctrl-C, SIGTERM or when the
    operator is done, and then prints its report.
    """
    import numpy as np

    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.spec import parse_channel
    from hapticnet.checks import check_parameter
    from hapticnet.cli.console import Console, check_outputs, deliver
    from hapticnet.cli.law import law_given
    from hapticnet.cli.master_messages import MasterMessages
    from hapticnet.cli.operators import make_operator
    from hapticnet.cli.pages import choose_operator
    from hapticnet.cli.watching import watch_master
    from hapticnet.codec.registry import parse_codec
    from hapticnet.errors import RefusedError, RunError, UnavailableError
    from hapticnet.experiment.provenance import provenance
    from hapticnet.node.master import MasterNode
    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.protocol.key_files import default_key
    from hapticnet.protocol.settings import SessionSettings
    from hapticnet.recordings.session.archive import check_format
    from hapticnet.recordings.session.in_force import settings_line
    from hapticnet.recordings.session.recovery import refuse_if_recorded
    from hapticnet.runtime import devices
    from hapticnet.runtime.clock import now_us
    from hapticnet.runtime.entropy import SystemEntropy
    from hapticnet.runtime.master_run import MasterRun, run_master
    from hapticnet.runtime.overload import Overload, signs
    from hapticnet.runtime.realtime import OTHER, policy, prefer_realtime, run
    from hapticnet.runtime.reports import master_report
    from hapticnet.runtime.rescue import Rescue
    from hapticnet.runtime.session_recordings import MasterRecording
    from hapticnet.runtime.trust import master_key, refusal_advice
    from hapticnet.runtime.udp import is_loopback, open_toward, parse_host_port

    weber_law = law_given(weber, floor, multiplier, law)
    check_parameter("--max-age", max_age, 0.01, 60.0, "s")
    known = devices.load(profile)
    address = parse_host_port(connect)
    sock, slave = open_toward(address)
    keys = master_key(address, is_loopback(slave), key, peer_key, insecure)
    codec_name, parameters = parse_codec(codec)
    settings = MasterSettings(
        codec=codec_name,
        parameters=parameters,
        law=weber_law,
        rate_hz=rate,
        name=name,
        key=keys,
        session=SessionSettings(max_age_us=round(max_age * 1e6)),
        record=record is not None,
        record_datagrams=record is not None,
        device_takes=device_takes,
        announced=announced,
        positions=positions,
        position_share=position_share,
        passive=passive,
        first_touch=first_touch,
        control=devices.control_settings(known),
    )
    console = Console(name, quiet=quiet, real_time=True)
    operator, served = choose_operator(operator, page, console)
    hand = make_operator(operator, insertions=insertions, seed=seed, say=console.say, warn=console.warn)
    channels = {"channel_out": parse_channel(channel_out), "channel_in": parse_channel(channel_in)}
    emulators = {
        way: None if spec.is_perfect and served is None else Emulator[Any](spec, np.random.default_rng([seed, number]))
        for number, (way, spec) in zip((2, 1), channels.items(), strict=True)
    }
    if duration is None and hand.operator.duration_us is not None:
        duration = hand.operator.duration_us / 1e6
    if record is not None:
        check_format(record)
        refuse_if_recorded(record)
        if record.exists():
            console.warn(f"{record} exists; it is replaced when this run ends")
    check_outputs(record, report, inputs=[profile, law, hand.file, None if keys is None else key or default_key()])
    console.warn_of_unused(
        {
            "--insertions": (
                insertions != INSERTIONS and operator.partition(":")[0] not in ("scripted", "palpation"),
                f"the operator is {operator}",
            ),
            "--position-share": (position_share != POSITION_SHARE and positions == "raw", "it needs --positions line"),
            "--device-takes": (device_takes != "x" and device == "none", "there is no device"),
            "--first-touch": (first_touch and device == "none", "there is no device"),
            "--profile": (profile is not None and device == "none", "there is no device"),
            "--record-limit": (record_limit != options.RECORD_LIMIT and record is None, "it needs --record"),
        }
    )
    scheduling = prefer_realtime() if real_time else OTHER
    kind = "an open session" if keys is None else "a sealed session"
    console.say(f"asking {address} for {kind}, {codec}, {rate:g} Hz, device {device}, {policy(scheduling)}")
    overload = Overload(scheduling, console.warn)
    recording: MasterRecording | None = None
    outcome: MasterRun | None = None

    def faults() -> list[str]:
        """Return what was wrong although the run went on."""
        return [*map(str, node.times.told), *rescue.faults, *console.faults]

    def conclude() -> None:
        """Deliver the report."""
        console.finish()
        busy = signs(overload.report())
        if busy and not node.times.told:  # else these say why
            console.warn(f"this machine was too busy for {1e6 / node.position_period_us:g} Hz: {'; '.join(busy)}")
        recorder = None if recording is None else recording.recorder
        account = master_report(
            node,
            outcome,
            overload,
            faults=[*rescue.faults, *console.faults],
            operator=hand.report(),
            recorder=recorder,
            **emulators,
        )
        in_force = [f"{each['t_s']:10.3f} s  {settings_line(each)}" for each in account["in_force"]]
        deliver(account, as_json=json, file=report, real_time=True, shown={**account, "in_force": in_force})

    rescue = Rescue(conclude)
    with devices.real_time_device(device, known, seed, console.warn) as (fingertip, wire):
        if wire and known.is_generic and device.startswith("serial:"):
            console.warn(devices.NOT_CALIBRATED)
        node = MasterNode(hand.operator, fingertip, settings, SystemEntropy(), now_us)
        emulated = {way: None if each is None else each.settings.describe() for way, each in emulators.items()}
        node.emulate(**emulated)
        messages = MasterMessages(console, node, str(address), keys)
        watchers: list[Watcher[NodeEvent]] = [messages, *hand.watchers]
        if served is not None:
            watchers += served.watchers(node, hand.operator, operator, device, str(address), channels, emulators)
        watchers += watch_master(node, console, overload, metrics=metrics)
        if record is not None:
            about = {"seed": seed, "operator": operator, "device": device, "provenance": provenance()}
            recording = MasterRecording(node, record, console.warn, limit_bytes=record_limit, about=about)
            watchers.append(recording)
        outcome = run(
            run_master(
                node,
                sock,
                slave,
                wire=wire,
                channel=emulators["channel_out"],
                channel_in=emulators["channel_in"],
                duration_s=duration,
                connect_timeout_s=connect_timeout,
                watchers=watchers,
                overload=overload,
                tell=console.fault,
                rescue=rescue,
            )
        )
    rescue.done()
    try:
        conclude()
    finally:  # the reader of stdout may have gone
        if recording is not None:
            recording.recorder.check()
    if node.refused:
        raise RefusedError(f"{address} refused the session: {node.end_reason}{refusal_advice(keys, messages.refusal)}")
    if node.failure is not None:
        raise UnavailableError(node.failure)
    if not outcome.connected and connect_timeout is not None:
        advice = messages.advice()
        if outcome.strangers:
            advice = "datagrams came from another address: name the one it answers from"
        raise UnavailableError(f"no session with {address} within {connect_timeout:g} s: {advice}")
    if faults():
        raise RunError("; ".join(faults()))
