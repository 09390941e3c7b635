"""``hn.virtual_link``: master, slave and an emulated network in virtual time, without sockets or waiting."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticnet.api.encoding import Table, make_codec
from hapticnet.api.inputs import serve_class
from hapticnet.arrays import FloatArray
from hapticnet.channel.spec import parse_channel
from hapticnet.checks import check_integer, check_parameter
from hapticnet.codec import registry
from hapticnet.codec.base import Codec
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.experiment.analysis import felt_error, felt_parts
from hapticnet.measure.metrics import ErrorReport, FeltReport
from hapticnet.node.loopback import Loopback, emulated
from hapticnet.node.settings import MasterSettings, Positions, SlaveSettings
from hapticnet.operator.base import HasSample, UserOperator
from hapticnet.operator.scripted import scripted_hand
from hapticnet.operator.yielding import is_hand, scripted_yielding
from hapticnet.parts import PartsLaw, written
from hapticnet.scene.base import HasStep, scene_parts
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.follower import Follower
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import as_touchable, find_source, make_scene

if TYPE_CHECKING:
    from hapticnet.operator.base import Operator
    from hapticnet.scene.base import Touchable

LONGEST_RUN_S = 1e5  # longest single run; its recordings take about ten gigabytes of memory


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LinkReport(Table):
    """Account of a virtual link so far."""

    scene: str
    codec: str
    """Names of the scene and the codec."""
    seconds: float
    """Virtual time since the link was made [s]."""
    samples: int
    sent: int
    keepalives: int
    """Positions answered by the slave; forces and keepalives it sent."""
    packet_rate_reduction: float
    """``1 - sent / samples``."""
    forward_wire_bytes: int
    feedback_wire_bytes: int
    """Bytes sent by master and slave, with 28 B of UDP and IPv4 headers each."""
    forward_lost: int
    feedback_lost: int
    """Datagrams that did not arrive at the slave and at the master."""
    round_trip_ms: float | None
    round_trip_p99_ms: float | None
    """Median and 99th percentile of the round-trip time [ms]; None if none was measured."""
    breaches: int
    """Tissues breached."""
    rmse_n: float
    max_error_n: float
    exceed_jnd_fraction: float
    """Error [N] of the force that the master applies if nothing is lost; see `ErrorReport`."""
    felt_rmse_n: float
    felt_max_error_n: float
    felt_exceed_jnd_fraction: float
    felt_above_2_jnd_fraction: float
    felt_above_4_jnd_fraction: float
    felt_above_8_jnd_fraction: float
    felt_p99_error_n: float
    """The same for the force held at the time of each position, which includes the effects of delay and loss; see
    `FeltReport`."""
    felt_parts: dict[str, FeltReport]
    """The same for every part; the above is that of the first. Empty without parts."""
    slave: dict[str, Any]
    master: dict[str, Any]
    """The complete reports of both sides."""

    def _table(self) -> tuple[Sequence[str], list[tuple[str, Any]]]:
        shown = [(name, value) for name, value in asdict(self).items() if name not in ("felt_parts", "slave", "master")]
        for part, felt in self.felt_parts.items():
            shown += [(f"felt_{name} of {part}", value) for name, value in asdict(felt).items()]
        return ("measure", "value"), shown


class VirtualLink:
    """Master and slave with an emulated network between them, as returned by `virtual_link`."""

    def __init__(self, loopback: Loopback, codec: Codec) -> None:
        self._loopback = loopback
        self._codec = codec

    def run(self, *, seconds: float) -> None:
        """Advance by `seconds` of virtual time.

        Raises
        ------
        SettingsError
            If `seconds` is not between 0 and 1e5.
        UnavailableError
            If the codec or the operator raised an error, which ends the session.
        """
        check_parameter("seconds", seconds, 0.0, LONGEST_RUN_S, "s")
        self._loopback.run(round(seconds * 1e6))
        if self._loopback.master.failure is not None:
            raise UnavailableError(f"the session ended: {self._loopback.master.failure}")

    def slave_samples(self) -> dict[str, FloatArray]:
        """Return, for every position the slave answered: t_us, position_m, force_n, held_n, transmitted and more.

        `node.recording.slave_columns` describes the columns; each has shape (n,). With several axes there are
        position_x_m, position_y_m and so on.

        Raises
        ------
        UnavailableError
            If no session has been established.
        """
        contexts = self._loopback.slave.contexts
        if not contexts or contexts[-1].recording is None or not contexts[-1].steps:
            raise UnavailableError(
                f"no session after {self._loopback.now_us / 1e6:g} s of virtual time; run longer or with less loss"
            )
        return contexts[-1].recording.table()

    def master_samples(self) -> dict[str, FloatArray]:
        """Return, for every tick of the master: t_us, position_m, held_n and more, shape (n,) each.

        `node.recording.master_columns` describes the columns.
        """
        recording = self._loopback.master.recording
        return recording.table() if recording is not None else {}

    def vibration_samples(self) -> dict[str, FloatArray]:
        """Return the vibration that was played: t_us, played_m_s2 and felt_m_s2 (of a simulated voice coil).

        Each has shape (n,), at 2800 Hz while something is felt; empty without ``vibration=True``.
        """
        vibration = self._loopback.master.vibration
        return vibration.recording.table() if vibration is not None and vibration.recording is not None else {}

    def report(self) -> LinkReport:
        """Return the account of the newest session.

        Raises
        ------
        UnavailableError
            If no session has been established.
        """
        samples = self.slave_samples()
        slave, master = self._loopback.slave.report()["sessions"][-1], self._loopback.master.report()
        law = self._loopback.master.codec.law
        felt = felt_error(law, samples, self.master_samples())
        from_slave = ("scene", "codec", "packet_rate_reduction", "breaches", *ErrorReport.__dataclass_fields__)
        round_trip = master["round_trip"]
        return LinkReport(
            **{name: slave[name] for name in from_slave},
            **{f"felt_{name}": value for name, value in asdict(felt).items()},
            seconds=self._loopback.now_us / 1e6,
            samples=slave["steps"],
            sent=slave["sent"]["by_kind"].get("force", 0),
            keepalives=slave["sent"]["by_kind"].get("keepalive", 0),
            forward_wire_bytes=master["sent"]["wire_bytes"],
            feedback_wire_bytes=slave["sent"]["wire_bytes"],
            forward_lost=slave["received"]["lost"],
            feedback_lost=master["received"]["lost"],
            round_trip_ms=None if round_trip["p50_us"] is None else round_trip["p50_us"] / 1e3,
            round_trip_p99_ms=None if round_trip["p99_us"] is None else round_trip["p99_us"] / 1e3,
            felt_parts=felt_parts(law, samples, self.master_samples()) if isinstance(law, PartsLaw) else {},
            slave=slave,
            master=master,
        )

    def __repr__(self) -> str:
        return f"<VirtualLink: {self._codec.name}, {self._loopback.now_us / 1e6:g} s of virtual time>"


def virtual_link(
    *,
    scene: str | HasStep = "paper:0",
    codec: str | Codec = "deadband",
    forward: str = "perfect",
    feedback: str = "perfect",
    rate_hz: float = 1000.0,
    fastest_rate_hz: float = 10_000.0,
    announced: bool = False,
    predicted: bool = False,
    vibration: bool = False,
    coupling: str = "direct",
    positions: Positions = "raw",
    position_share: float = 0.25,
    operator: HasSample | str | None = None,
    seed: int = 0,
    weber_fraction: float | None = None,
    floor_n: float | None = None,
    multiplier: float | None = None,
    part_laws: dict[str, tuple[float, float]] | None = None,
    **parameters: float,
) -> VirtualLink:
    """Connect a master and a slave over an emulated network in virtual time.

    The same arguments give the same run, byte for byte.

    Parameters
    ----------
    scene
        ``"paper:SEED"``, the name of a preset, the path of a .toml file, ``"FILE.py:Class"``, or any object with a
        method ``step(sample)``.
    codec, weber_fraction, floor_n, multiplier, **parameters
        The feedback codec; see `make_codec`.
    forward, feedback
        The network from master to slave and back: a preset (perfect, lan, wifi, 4g, transatlantic, satellite), parts
        such as ``"delay=20ms,loss=2%"``, or both, as in ``"wifi,loss=5%"``.
    rate_hz
        Ticks of the master per second. It sends a position in each.
    fastest_rate_hz
        Most positions per second that the slave grants. The master then sends fewer, and ticks as often.
    announced
        Whether the scene announces the contact ahead, and the master renders it without delay.
    predicted
        Whether the slave answers for where the hand will be when the force arrives, on a copy of the scene.
    vibration
        Whether the scene's vibration comes beside the force; `VirtualLink.vibration_samples` returns it.
    coupling
        How to keep a hand that yields from oscillating: ``"direct"``, ``"energy-bounded"``, or that of a package.
    positions, position_share
        Which positions are sent, ``"raw"`` or ``"line"``, and the share of the JND that those of ``"line"`` may use.
    operator
        Source of the positions: any object with a method ``sample(t_us)``, or text such as ``"hand:arm"``: a hand that
        the force moves (`operator.yielding.parse_hand`). Default: scripted needle insertions, or palpation of a scene
        on several axes.
    seed
        Seed of hand and network.
    part_laws
        Weber fraction and smallest threshold of torque or grip, instead of the published ones (`hapticnet.parts`).

    Raises
    ------
    SettingsError
        If a value cannot be used.
    FileError
        If the scene's file cannot be read.
    """
    chosen = make_codec(codec, weber_fraction=weber_fraction, floor_n=floor_n, multiplier=multiplier, **parameters)
    serve_class(type(chosen))
    check_integer("seed", seed, 0, 2**63)
    for name, text in (("forward", forward), ("feedback", feedback)):
        if not isinstance(text, str):
            raise SettingsError(f"{name} is {text!r}; it must be text, such as 'wifi' or 'delay=20ms,loss=2%'")
    touched: Touchable
    if isinstance(scene, Scene | BodyScene | Follower):  # at rest, so that every run is the same
        touched = make_scene(scene.settings)
    else:
        touched = find_source(scene).make() if isinstance(scene, str) else as_touchable(scene)
    channels = {"forward": parse_channel(forward), "feedback": parse_channel(feedback)}
    hand: Operator
    if operator is None and scene_parts(touched):
        raise SettingsError(f"scene {touched.name} has the parts {written(scene_parts(touched), 0)}: give an operator")
    if operator is None:
        hand = scripted_hand(touched.axes, 100, np.random.default_rng([seed, 3]))
    elif isinstance(operator, str):
        if not is_hand(operator):
            raise SettingsError(f"operator is {operator!r}; it must be an object, or text such as 'hand:arm'")
        hand = scripted_yielding(operator, touched.axes, 100, np.random.default_rng([seed, 3]))
    else:
        hand = UserOperator(operator, "operator")
    settings = MasterSettings(
        codec=chosen.name,
        parameters=registry.codec_parameters(chosen),
        law=chosen.law,
        part_laws=part_laws or {},
        rate_hz=rate_hz,
        record=True,
        announced=announced,
        predicted=predicted,
        vibration=vibration,
        coupling=coupling,
        positions=positions,
        position_share=position_share,
    )
    slave = SlaveSettings(record=True, fastest_rate_hz=fastest_rate_hz)
    return VirtualLink(emulated(hand, touched, settings, **channels, seed=seed, slave=slave), chosen)
