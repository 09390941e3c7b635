"""One trial of the ordering task: its stimulus, the hand of a simulated observer, and its result."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.codec.registry import parse_codec
from hapticnet.experiment.analysis import spent_until
from hapticnet.node.events import SettingsInForce
from hapticnet.node.master import MasterNode
from hapticnet.node.recording import IN
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import TREMOR_BAND_HZ, TREMOR_SINUSOIDS, TYPICAL_TREMOR_RMS_M
from hapticnet.operator.trace import TraceOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet_experiment.plan import ConditionPlan, Plan
from hapticnet_experiment.scene import master_name, tissues

LINK_LOST: Final = "the link was lost"
LATE_US: Final = 200_000  # time [µs] after a contact during which the device may still deliver its force
LEAST_HELD_N: Final = 0.3  # held peak [N] below which a contact is a graze: below about 0.2 N the sensor feels nothing
STEP_US: Final = 1000
INSERTIONS: Final = 2
MARGIN_M: Final = 2e-3  # a push begins this far before the surface and ends this far behind the breach
# Duration of a push [s], of which about 0.6 s are contact. At 0.24 s, the device reaches two thirds of 5 N only.
PUSH_S: Final = 1.1
BETWEEN_S: Final = 0.25
WITHDRAW_S: Final = 0.5
REST_S: Final = 0.3
VARIATION: Final = 0.1  # share by which these durations [s] vary; all are assumptions


@dataclass(frozen=True, slots=True, kw_only=True)
class Stimulus:
    """The stimulus of a trial."""

    number: int  # number of the trial, for the name of the session
    breach_forces_n: tuple[float, ...]  # front to back
    gap_m: float  # between surfaces
    codec: str  # as written for ``--codec``
    law: WeberLaw  # the participant's, with the threshold of the condition
    rate_hz: float  # positions a second
    forward: str  # emulated networks
    feedback: str
    seed: int  # of hand, network and device
    limit_s: float  # longest duration

    @property
    def tissues(self) -> tuple[Tissue, ...]:
        """The tissues, front to back."""
        return tissues(self.breach_forces_n, self.gap_m)

    @property
    def surfaces_m(self) -> tuple[float, ...]:
        """Surfaces at rest [m], front to back."""
        return tuple(tissue.rest_position_m for tissue in self.tissues)

    @property
    def name(self) -> str:
        """Name of the master, which asks the slave for these tissues."""
        return master_name(self.number, self.breach_forces_n, self.gap_m)

    def master_settings(self, settings: MasterSettings) -> MasterSettings:
        """Return the settings of the master that plays it, based on the rig's."""
        codec, parameters = parse_codec(self.codec)
        return replace(
            settings,
            codec=codec,
            parameters=parameters,
            law=self.law,
            rate_hz=self.rate_hz,
            name=self.name,
            record=True,
            record_datagrams=True,
        )


def stimulus_of(
    plan: Plan, condition: ConditionPlan, law: WeberLaw, *, number: int, breach_forces_n: tuple[float, ...], seed: int
) -> Stimulus:
    """Return the stimulus of a plan's trial, from the participant's law at 1 JND.

    A condition without a threshold is described by the threshold of 1 JND.
    """
    return Stimulus(
        number=number,
        breach_forces_n=breach_forces_n,
        gap_m=plan.order.gap_m,
        codec=condition.codec,
        law=replace(law, multiplier=condition.threshold or 1.0),
        rate_hz=plan.link.rate_hz,
        forward=plan.link.forward,
        feedback=plan.link.feedback,
        seed=seed,
        limit_s=plan.order.time_limit_s,
    )


def scripted_hand(stimulus: Stimulus) -> Operator:
    """Return the hand of a simulated observer, drawn from the seed of the trial.

    It pauses between tissues, never within one, so that a pause does not reveal the place.
    """
    rng = np.random.default_rng([stimulus.seed, 3])
    places_m, durations_s = [0.0], []
    for _ in range(INSERTIONS):
        for tissue in stimulus.tissues:
            places_m += [tissue.rest_position_m - MARGIN_M]
            places_m += [tissue.rest_position_m + tissue.breach_depth_m + MARGIN_M]
            durations_s += [BETWEEN_S, PUSH_S]
        places_m += [0.0, 0.0]
        durations_s += [WITHDRAW_S, REST_S]
    drawn_s = np.array(durations_s) * rng.uniform(1.0 - VARIATION, 1.0 + VARIATION, len(durations_s))
    phases = [
        _minimum_jerk(from_m, to_m, max(2, round(1e6 * duration_s) // STEP_US))
        for (from_m, to_m), duration_s in zip(pairwise(places_m), drawn_s.tolist(), strict=True)
    ]
    position_m = np.concatenate(phases)
    t_us = np.arange(len(position_m), dtype=np.int64) * STEP_US
    position_m += _tremor_m(t_us, rng)
    return TraceOperator(t_us, position_m[:, np.newaxis])


def _minimum_jerk(from_m: float, to_m: float, samples: int) -> FloatArray:
    """Return a movement after Flash and Hogan 1985 (`operator.scripted.ScriptedOperator`), shape (samples,)."""
    tau = np.arange(samples) / samples
    moved: FloatArray = from_m + (to_m - from_m) * tau**3 * (10.0 + tau * (6.0 * tau - 15.0))
    return moved


def _tremor_m(t_us: npt.NDArray[np.int64], rng: np.random.Generator) -> FloatArray:
    low_hz, high_hz = TREMOR_BAND_HZ
    frequencies_hz = rng.uniform(low_hz, high_hz, TREMOR_SINUSOIDS)
    phases = rng.uniform(0.0, 2.0 * np.pi, TREMOR_SINUSOIDS)
    waves = np.sin(2e-6 * np.pi * frequencies_hz * t_us[:, np.newaxis] + phases)
    tremor: FloatArray = TYPICAL_TREMOR_RMS_M * np.sqrt(2.0 / TREMOR_SINUSOIDS) * waves.sum(axis=1)
    return tremor


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Figures of a trial. Tuples have one value for each tissue, front to back; None if it was not touched.

    Bytes are with UDP and IPv4 headers. Those of penetrations are counted from the touch of a tissue to its breach,
    with keepalives, as in `experiment.analysis.spent_until`.
    """

    first_contact_s: float | None = None  # from the start of the scene; None without a contact
    insertions: int = 0  # how often the needle entered the first tissue
    penetrations: int = 0  # surfaces breached
    peaks_held_n: tuple[float | None, ...] = (None, None, None)
    peaks_sensed_n: tuple[float | None, ...] = (None, None, None)
    peak_speed_m_per_s: float | None = None  # into the tissue while in contact
    perceptual_error: float | None = None  # see `_perceptual_error`
    force_packets: int = 0  # FORCE datagrams received in the whole trial
    wire_bytes: int = 0  # bytes of these
    penetration_packets: int = 0
    penetration_bytes: int = 0
    missed_ticks: int = 0
    link_stale: int = 0  # how often the link was silent

    @property
    def touched_all(self) -> bool:
        """Whether each tissue was touched."""
        return None not in (*self.peaks_held_n, *self.peaks_sensed_n)

    def undelivered(self, least: float) -> str | None:
        """Return why the trial must be repeated; None if every tissue was touched and its force delivered.

        `least` is the share of the held peak that the sensed peak must reach.
        """
        peaks = zip(self.peaks_held_n, self.peaks_sensed_n, strict=True)
        for number, (held_n, sensed_n) in enumerate(peaks, start=1):
            if held_n is None or sensed_n is None:
                return f"tissue {number} was not touched"
            if sensed_n < least * held_n:
                return f"the device delivered {sensed_n:.2f} of {held_n:.2f} N in tissue {number}"
        return None


NO_MEASURES: Final = Measures()


@dataclass(frozen=True, slots=True, kw_only=True)
class Played:
    """A trial that was played."""

    stimulus: Stimulus
    measures: Measures
    ticks: dict[str, FloatArray]  # `node.recording.master_columns`, shape (n,)
    datagrams: dict[str, FloatArray]  # `DATAGRAM_COLUMNS`, shape (n,)
    settings: MasterSettings  # requested by the master
    in_force: tuple[tuple[int, SettingsInForce], ...]  # settings in force, and their start [µs]
    unix_offset_us: int = 0  # add it to all times for µs since 1970; 0 in virtual time
    failure: str | None = None  # why it was aborted; None if it ended by itself or with an answer


def played(
    node: MasterNode, stimulus: Stimulus, failure: str | None, missed_ticks: int, unix_offset_us: int
) -> Played | None:
    """Return a master's record of a trial; None if it sent no position."""
    assert node.recording is not None  # noqa: S101 - `Stimulus.master_settings` asks for both
    assert node.datagrams is not None  # noqa: S101
    if not len(node.recording):
        return None
    ticks, datagrams = node.recording.table(), node.datagrams.table()
    forces = (datagrams["direction"] == IN) & (datagrams["kind"] == float(Kind.FORCE))
    replayed = _replay(ticks, stimulus.tissues)
    packets, spent = _spent(ticks, datagrams, replayed)
    held_n, sensed_n = _peaks(ticks, stimulus.surfaces_m)
    touching = np.flatnonzero(ticks["held_n"] > 0.0)
    inside = ticks["position_m"] >= stimulus.surfaces_m[0]
    speed = np.diff(ticks["position_m"]) / np.maximum(np.diff(ticks["t_us"]), 1.0) * 1e6
    speed = speed[ticks["held_n"][1:] > 0.0]
    measures = Measures(
        first_contact_s=float(ticks["t_us"][touching[0]] - ticks["t_us"][0]) * 1e-6 if len(touching) else None,
        insertions=int(np.count_nonzero(inside[1:] & (ticks["position_m"][:-1] < stimulus.surfaces_m[0]))),
        penetrations=len(packets),
        peaks_held_n=held_n,
        peaks_sensed_n=sensed_n,
        peak_speed_m_per_s=float(max(speed.max(), 0.0)) if len(speed) else None,
        perceptual_error=_perceptual_error(ticks, replayed),
        force_packets=int(forces.sum()),
        wire_bytes=int((datagrams["datagram_bytes"][forces] + UDP_IPV4_HEADER_BYTES).sum()),
        penetration_packets=sum(packets),
        penetration_bytes=sum(spent),
        missed_ticks=missed_ticks,
        link_stale=int(failure == LINK_LOST),
    )
    return Played(
        stimulus=stimulus,
        measures=measures,
        ticks=ticks,
        datagrams=datagrams,
        settings=node.settings,
        in_force=tuple(
            (t_us, replace(each, channel_out=stimulus.forward, channel_in=stimulus.feedback))
            for t_us, each in node.in_force.history
        ),
        unix_offset_us=unix_offset_us,
        failure=failure,
    )


@dataclass(frozen=True, slots=True)
class _Replay:
    """The tissues at each tick with a position."""

    known: npt.NDArray[np.bool_]  # whether a tick has a position
    force_n: FloatArray
    breaches: FloatArray  # number of them so far


def _replay(ticks: dict[str, FloatArray], felt: Sequence[Tissue]) -> _Replay:
    """Return the response of the tissues, in their state at the start of the trial, at each tick."""
    scene = Scene(felt)
    known = np.isfinite(ticks["position_m"])
    places = zip(ticks["t_us"][known].tolist(), ticks["position_m"][known].tolist(), strict=True)
    steps = [(scene.step(PositionSample(int(t_us), (tip_m,))).force_n[0], scene.breaches) for t_us, tip_m in places]
    force_n, breaches = np.array(steps, dtype=np.float64).reshape(-1, 2).T
    return _Replay(known, force_n, breaches)


def _spent(
    ticks: dict[str, FloatArray], datagrams: dict[str, FloatArray], replayed: _Replay
) -> tuple[list[int], list[int]]:
    """Return datagrams and bytes from the slave for each penetration."""
    t_us = ticks["t_us"][replayed.known]
    back = (datagrams["direction"] == IN) & np.isin(datagrams["kind"], [float(Kind.FORCE), float(Kind.KEEPALIVE)])
    tick = np.clip(np.searchsorted(t_us, datagrams["t_us"][back], side="right") - 1, 0, None)
    wire = datagrams["datagram_bytes"][back] + UDP_IPV4_HEADER_BYTES
    breaches = np.flatnonzero(np.diff(replayed.breaches, prepend=0.0) > 0)
    packets, spent = (
        spent_until(np.bincount(tick, weights, len(t_us)).astype(np.float64), replayed.force_n > 0.0, breaches)
        for weights in (np.ones(len(tick)), wire)
    )
    return packets, spent


def _perceptual_error(ticks: dict[str, FloatArray], replayed: _Replay) -> float | None:
    """Return the root mean square of ln(held force / force of the tissues at the same moment); None without contact.

    Codec, delay and losses all add to it. Equal ratios count the same, as in the perceptual mean squared error of
    Chaudhari, Steinbach & Hirche, "Towards an objective quality evaluation framework for haptic data reduction", World
    Haptics Conference 2011. Moments with less than `LEAST_HELD_N` from the tissues are omitted, because a breach, late
    by 2 ms, would outweigh all the rest; a smaller held force counts as that much.
    """
    true_n, held_n = replayed.force_n, ticks["held_n"][replayed.known]
    contact = true_n > LEAST_HELD_N
    if not contact.any():
        return None
    errors = np.log(np.maximum(held_n[contact], LEAST_HELD_N) / true_n[contact])
    return float(np.sqrt(np.mean(errors**2)))


def _peaks(
    ticks: dict[str, FloatArray], surfaces_m: Sequence[float]
) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """Return the largest held and sensed force [N] in each tissue.

    A contact is a run of held force, and belongs to the tissue in which it was largest. Its sensed force may come up to
    `LATE_US` after it, but not after the next contact has begun.
    """
    held_n, sensed_n, t_us = ticks["held_n"], ticks["sensed_n"], ticks["t_us"]
    largest_n: list[float | None] = [None] * len(surfaces_m)
    delivered_n: list[float | None] = [None] * len(surfaces_m)
    edges = np.flatnonzero(np.diff((held_n > 0.0).astype(np.int8), prepend=0, append=0))
    starts, stops = edges[::2].tolist(), edges[1::2].tolist()
    for start, stop, following in zip(starts, stops, [*starts, len(held_n)][1:], strict=True):
        peak = start + int(held_n[start:stop].argmax())
        if held_n[peak] < LEAST_HELD_N:
            continue
        tissue = int(np.searchsorted(surfaces_m, ticks["position_m"][peak], side="right")) - 1
        late = int(np.searchsorted(t_us, t_us[stop - 1] + LATE_US))
        felt_n = float(sensed_n[start : max(stop, min(late, following))].max())
        tissue = max(tissue, 0)
        largest_n[tissue] = max(largest_n[tissue] or 0.0, float(held_n[peak]))
        delivered_n[tissue] = max(delivered_n[tissue] or 0.0, felt_n)
    return tuple(largest_n), tuple(delivered_n)
