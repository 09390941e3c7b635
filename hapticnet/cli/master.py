"""A master from its options: its node, its watchers, its messages, and its report."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.cli.console import Console, check_outputs, deliver
from hapticnet.cli.given import MasterOptions
from hapticnet.cli.law import law_given
from hapticnet.cli.operators import make_operator
from hapticnet.cli.pages import choose_operator
from hapticnet.cli.watching import watch_for_programs
from hapticnet.codec.registry import parse_codec
from hapticnet.errors import RefusedError, RunError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.node.events import Failed, HeldBack, NodeEvent, Paused, Resumed, SettingsInForce
from hapticnet.node.fingertip import MAY_SWING, DeviceFound, DeviceLost, FingerMet, FingerNotMet, ForceFault
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.operator.mapping import Mapping
from hapticnet.options import INSERTIONS, POSITION_SHARE, RECORD_LIMIT, VIBRATION_BUDGET
from hapticnet.protocol.key_files import default_key
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import (
    ChangeRefused,
    Connected,
    Ended,
    Hinted,
    LinkRecovered,
    LinkStale,
    Noticed,
    Refused,
    SessionLost,
)
from hapticnet.recordings.session.archive import check_format
from hapticnet.recordings.session.mcap_writer import DISTURBANCES
from hapticnet.recordings.session.session import settings_line
from hapticnet.recordings.session.sink import refuse_if_recorded
from hapticnet.runtime import devices
from hapticnet.runtime.overload import Overload, signs
from hapticnet.runtime.recorder import MasterRecording
from hapticnet.runtime.runners import MasterRun, master_report, run_master
from hapticnet.runtime.signals import Rescue
from hapticnet.runtime.system import OTHER, SystemEntropy, now_us, policy, prefer_realtime, run
from hapticnet.runtime.trust import master_key, refusal_advice, silence_advice
from hapticnet.runtime.udp import is_loopback, open_toward, parse_host_port
from hapticnet.runtime.watching import Watcher

if TYPE_CHECKING:
    from hapticnet.protocol.keys import MasterKey
    from hapticnet.protocol.messages import Grant


ADVISE_AFTER: Final = 6  # status intervals without a session before advice is printed: 3 s
WORDS: Final[dict[type, str]] = {
    LinkRecovered: "link recovered",
    SessionLost: "session lost ({0.reason}); asking for a new one",
    ChangeRefused: "the slave refuses the change ({0.reason}); the session continues unchanged",
    Hinted: "unauthenticated refusal ({0.reason}); asking again",
    FingerNotMet: "finger not found, so the first force will search for it: {0.reason}",
    DeviceFound: "device ready: {0.description}",
    DeviceLost: "device lost ({0.reason}); the session continues, the finger feels nothing",
    Paused: "{0.reason}; the force goes to zero until the operator is resumed",
    Resumed: "the operator is asked again; the force rises from zero",
    Failed: "{0.reason}; the force goes to zero and the session is closed",
    Noticed: "the slave says: {0.reason}",
    StepsTooSlow: "{0}",
    HeldBack: "the force is held back, so that the hand does not begin to swing",
    ForceFault: "platform retracted: {0.reason}",
}  # messages for a person that need only the event


def join(given: MasterOptions) -> None:
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
        key=keys,
        session=SessionSettings(max_age_us=round(given.max_age * 1e6)),
        record=given.record is not None,
        record_datagrams=given.record is not None,
        **given.of_node(),
        mapping=Mapping.parse(given.scale, given.force_scale, given.frame, given.offset),
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
                given.insertions != INSERTIONS and operator.partition(":")[0] not in ("scripted", "palpation", "hand"),
                f"the operator is {operator}",
            ),
            "--position-share": (
                given.position_share != POSITION_SHARE and given.positions == "raw",
                "it needs --positions line",
            ),
            "--vibration-budget": (
                given.vibration_budget != VIBRATION_BUDGET and not given.vibration,
                "it needs --vibration",
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
        """Return the faults that did not end the run."""
        return [*map(str, node.times.reported), *rescue.faults, *console.faults]

    def conclude() -> None:
        """Deliver the report."""
        console.finish()
        busy = signs(overload.report())
        if busy and not node.times.reported:  # otherwise these say why
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
        for line in node.adaptations:
            (console.warn if line == MAY_SWING else console.say)(line)
        messages = MasterMessages(console, node, str(address), keys)
        watchers: list[Watcher[NodeEvent]] = [messages, *hand.watchers]
        if served is not None:
            watchers += served.watchers(
                node, hand.operator, operator, given.device, channels, emulators,
                lambda event: in_words(event, node, str(address)),
            )  # fmt: skip
        watchers += watch_for_programs(node, console, overload, metrics=given.metrics, status=lambda: status(node))
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
        advice = refusal_advice(keys, messages.refusal)
        if served is not None and messages.refusal is Code.AXES:
            advice = "; give the page as many with --operator page:axes=N"
        raise RefusedError(f"{address} refused the session: {node.end_reason}{advice}")
    if node.failure is not None:
        raise UnavailableError(node.failure)
    if not outcome.connected and given.connect_timeout is not None:
        advice = messages.advice()
        if outcome.unknown_peers:
            advice = "datagrams came from another address: name the one it answers from"
        raise UnavailableError(f"no session with {address} within {given.connect_timeout:g} s: {advice}")
    if faults():
        raise RunError("; ".join(faults()))


class MasterMessages(Watcher[NodeEvent]):
    """Messages about events, advice while there is no session, and the status line."""

    name = "messages"

    def __init__(self, console: "Console", node: MasterNode, address: str, keys: "MasterKey | None") -> None:
        self.refusal: Code | None = None  # why the slave refused the first session, if it did
        self._console = console
        self._node = node
        self._address = address
        self._keys = keys
        self._hint: str | None = None
        self._intervals = 0
        self._unused: set[str] = set()

    def note(self, event: NodeEvent, now_us: int) -> None:  # noqa: ARG002 - messages have their own time
        """Print the events."""
        if isinstance(event, SettingsInForce):  # for recordings: a person sees it with the session, or asked for it
            return
        if isinstance(event, Connected):
            self._intervals = ADVISE_AFTER
        elif isinstance(event, Ended) and event.refused:
            self.refusal = event.code
        elif isinstance(event, Hinted):
            self._hint = event.reason
        failed = isinstance(event, Ended) and (event.refused or self._node.failure is not None)
        tell = self._console.warn if failed or type(event).__name__ in DISTURBANCES else self._console.say
        tell(in_words(event, self._node, self._address))
        if isinstance(event, Connected):
            self._warn_of_unused(event.grant)

    def _warn_of_unused(self, grant: "Grant") -> None:
        """Warn, once, of requests that the scene cannot fulfil."""
        settings, why = self._node.settings, f"the scene {grant.scene} gives no bound of its stiffness"
        line = settings.positions == "line" and not grant.position_share
        unused = {
            "--announced": (settings.announced and not grant.announced, f"the scene {grant.scene} announces nothing"),
            "--predicted": (settings.predicted and not grant.predicted, f"the scene {grant.scene} cannot be copied"),
            "--vibration": (settings.vibration and not grant.vibration, f"the scene {grant.scene} does not vibrate"),
            "--positions line": (line, f"{why}, so every position is sent"),
        }
        self._console.warn_of_unused({name: each for name, each in unused.items() if name not in self._unused})
        self._unused |= {name for name, (is_unused, _) in unused.items() if is_unused}

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Give advice if there is no session yet, and update the status line."""
        self._intervals += 1
        if self._intervals == ADVISE_AFTER:
            self._console.warn(f"no session with {self._address} yet: {self.advice()}")
        self._console.status(status(self._node))

    def advice(self) -> str:
        """Return advice while no slave answers."""
        return silence_advice(self._keys, self._node.session.received.malformed, self._hint)


def in_words(event: NodeEvent, node: MasterNode, address: str) -> str:
    """Return an event of `node` in words for a person; `address` is the slave's."""
    if isinstance(event, Connected):
        grant, codec = event.grant, node.codec
        scene = f"scene {grant.scene}" + (f" ({grant.frame})" if grant.frame else "")
        resumed = ", as it was left" if grant.resumed else ""
        jnd = "" if codec.name == "raw" else f" at {codec.law.multiplier:g} JND"
        beside = " with vibration" * grant.vibration
        return f"connected to {address}, {scene}{resumed}, {grant.rate_hz:g} Hz granted, {codec.name}{jnd}{beside}"
    if isinstance(event, SettingsInForce):
        return f"in force: {settings_line(asdict(event))}"
    if isinstance(event, LinkStale):
        if event.too_old_us is None:
            return "link stale: nothing arrived from the slave; the held force decays to zero"
        return (
            f"link too slow: forces answer positions {event.too_old_us / 1e6:.2f} s old, which is above --max-age;"
            " the held force decays to zero"
        )
    if isinstance(event, Refused):
        return f"the slave refuses a new session ({event.reason}); asking again in {event.retry_us / 1e6:g} s"
    if isinstance(event, FingerMet):
        return f"finger touched at {1e3 * event.contact_m:.1f} mm, {event.stiffness_n_m / 1e3:.1f} N/mm"
    if isinstance(event, Ended):
        return "session ended" if event.reason == node.failure else f"session ended: {event.reason}"
    return WORDS[type(event)].format(event)


def status(node: MasterNode) -> str:
    """Return the status line of a master."""
    session = node.session
    round_trip_us = session.round_trip.percentile(50)
    held_n = ", ".join(f"{component:.2f}" for component in node.held_n)
    return (
        f"{session.state.value}, holding {held_n} N, {session.sent.packets} packets out,"
        f" {session.received.packets} in, {session.received.lost} lost"
        + (f", round trip {round_trip_us / 1000:.2f} ms" if round_trip_us else "")
    )
