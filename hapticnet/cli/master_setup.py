"""A master from its options: its node, what looks on, and its report."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
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
from hapticnet.node.settings import MasterSettings
from hapticnet.options import INSERTIONS, POSITION_SHARE, RECORD_LIMIT
from hapticnet.protocol.key_files import default_key
from hapticnet.protocol.settings import SessionSettings
from hapticnet.recordings.session.archive import check_format
from hapticnet.recordings.session.recovery import refuse_if_recorded
from hapticnet.recordings.session.session import settings_line
from hapticnet.runtime import devices
from hapticnet.runtime.overload import Overload, signs
from hapticnet.runtime.runners import MasterRun, master_report, run_master
from hapticnet.runtime.session_recordings import MasterRecording
from hapticnet.runtime.signals import Rescue
from hapticnet.runtime.system import OTHER, SystemEntropy, now_us, policy, prefer_realtime, run
from hapticnet.runtime.trust import master_key, refusal_advice
from hapticnet.runtime.udp import is_loopback, open_toward, parse_host_port

if TYPE_CHECKING:
    from hapticnet.cli.master import MasterOptions
    from hapticnet.node.events import NodeEvent
    from hapticnet.runtime.watching import Watcher


def join(given: "MasterOptions") -> None:
    """Ask a slave for a session, run it until the end, and deliver the report."""
    weber_law = law_given(given.weber, given.floor, given.multiplier, given.law)
    known = devices.load(given.profile)
    address = parse_host_port(given.connect)
    sock, slave = open_toward(address)
    keys = master_key(address, is_loopback(slave), given.key, given.peer_key, given.insecure)
    codec_name, parameters = parse_codec(given.codec)
    settings = MasterSettings(
        codec=codec_name,
        parameters=parameters,
        law=weber_law,
        rate_hz=given.rate,
        name=given.name,
        key=keys,
        session=SessionSettings(max_age_us=round(given.max_age * 1e6)),
        record=given.record is not None,
        record_datagrams=given.record is not None,
        device_takes=given.device_takes,
        announced=given.announced,
        positions=given.positions,
        position_share=given.position_share,
        passive=given.passive,
        first_touch=given.first_touch,
        control=devices.control_settings(known),
    )
    console = Console(given.name, quiet=given.quiet, real_time=True)
    operator, served = choose_operator(given.operator, given.page, console)
    hand = make_operator(operator, insertions=given.insertions, seed=given.seed, say=console.say, warn=console.warn)
    channels = {"channel_out": parse_channel(given.channel_out), "channel_in": parse_channel(given.channel_in)}
    emulators = {
        way: None
        if spec.is_perfect and served is None
        else Emulator[Any](spec, np.random.default_rng([given.seed, number]))
        for number, (way, spec) in zip((2, 1), channels.items(), strict=True)
    }
    duration = given.duration
    if duration is None and hand.operator.duration_us is not None:
        duration = hand.operator.duration_us / 1e6
    if given.record is not None:
        check_format(given.record)
        refuse_if_recorded(given.record)
        if given.record.exists():
            console.warn(f"{given.record} exists; it is replaced when this run ends")
    check_outputs(
        given.record,
        given.report,
        inputs=[given.profile, given.law, hand.file, None if keys is None else given.key or default_key()],
    )
    console.warn_of_unused(
        {
            "--insertions": (
                given.insertions != INSERTIONS and operator.partition(":")[0] not in ("scripted", "palpation"),
                f"the operator is {operator}",
            ),
            "--position-share": (
                given.position_share != POSITION_SHARE and given.positions == "raw",
                "it needs --positions line",
            ),
            "--device-takes": (given.device_takes != "x" and given.device == "none", "there is no device"),
            "--first-touch": (given.first_touch and given.device == "none", "there is no device"),
            "--profile": (given.profile is not None and given.device == "none", "there is no device"),
            "--record-limit": (given.record_limit != RECORD_LIMIT and given.record is None, "it needs --record"),
        }
    )
    scheduling = prefer_realtime() if given.real_time else OTHER
    kind = "an open session" if keys is None else "a sealed session"
    wanted = f"{kind}, {given.codec}, {given.rate:g} Hz, device {given.device}"
    console.say(f"asking {address} for {wanted}, {policy(scheduling)}")
    overload = Overload(scheduling, console.warn)
    recording: MasterRecording | None = None
    outcome: MasterRun | None = None

    def faults() -> list[str]:
        """Return what was wrong although the run went on."""
        return [*map(str, node.times.reported), *rescue.faults, *console.faults]

    def conclude() -> None:
        """Deliver the report."""
        console.finish()
        busy = signs(overload.report())
        if busy and not node.times.reported:  # else these say why
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
        deliver(account, as_json=given.json, file=given.report, real_time=True, shown={**account, "in_force": in_force})

    rescue = Rescue(conclude)
    with devices.real_time_device(given.device, known, given.seed, console.warn) as (fingertip, wire):
        if wire and known.is_generic and given.device.startswith("serial:"):
            console.warn(devices.NOT_CALIBRATED)
        node = MasterNode(hand.operator, fingertip, settings, SystemEntropy(), now_us)
        emulated = {way: None if each is None else each.settings.describe() for way, each in emulators.items()}
        node.emulate(**emulated)
        messages = MasterMessages(console, node, str(address), keys)
        watchers: list[Watcher[NodeEvent]] = [messages, *hand.watchers]
        if served is not None:
            watchers += served.watchers(node, hand.operator, operator, given.device, str(address), channels, emulators)
        watchers += watch_master(node, console, overload, metrics=given.metrics)
        if given.record is not None:
            about = {"seed": given.seed, "operator": operator, "device": given.device, "provenance": provenance()}
            recording = MasterRecording(node, given.record, console.warn, limit_bytes=given.record_limit, about=about)
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
                connect_timeout_s=given.connect_timeout,
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
    if not outcome.connected and given.connect_timeout is not None:
        advice = messages.advice()
        if outcome.unknown_peers:
            advice = "datagrams came from another address: name the one it answers from"
        raise UnavailableError(f"no session with {address} within {given.connect_timeout:g} s: {advice}")
    if faults():
        raise RunError("; ".join(faults()))
