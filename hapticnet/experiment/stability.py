"""Whether a hand that yields can hold a tissue over a link: presses in virtual time, through the real nodes.

The hand presses with a given force, is jerked, rests, and then moves slowly in contact. A grounded device pushes the
hand, and a late force feeds energy back: the hand may swing for ever. A map has a trial for each delay and stiffness.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.channel.settings import ChannelSettings
from hapticnet.errors import SettingsError
from hapticnet.experiment.style import GREY, SKY, VERMILION, legend, picture
from hapticnet.experiment.workers import workers
from hapticnet.measure.energy import energy_report
from hapticnet.measure.stability import STIFFNESS_JND, Onset, sampled_onset
from hapticnet.node.loopback import emulated
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.yielding import HANDS, GroundedSettings, HandSettings, YieldingOperator
from hapticnet.samples import PositionSample
from hapticnet.scene.base import Touchable
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import LARGEST_VALUE, SceneSettings, Tissue
from hapticnet.scene.sources import SceneSource, make_scene

SMALL_SWING_M: Final = 0.2e-3
"""Swing of the hand [m], peak to peak, that does not matter: a resting hand trembles as much (`TYPICAL_TREMOR_RMS_M`,
50 µm rms, is 0.14 mm from peak to peak for a sine)."""

SMALL_SWING_JND: Final = 2.0
"""Swing of the force [JND], peak to peak, that does not matter: a deadband of 1 JND allows it."""

DECAYS, GENTLY_DECAYS = 0.7, 0.95
"""A larger swing still settles if it falls below this share from one window to the next, and the hand does not leave
the surface. A swing that stays varies too, as codecs round; in the gentle search for an onset it does not."""

THROWN_M: Final = 0.1  # a hand that swings so far loses the device
PRESS_N: Final = 3.0  # force of the press
JERK_M, GENTLE_JERK = 0.003, 0.2  # how far the hand is jerked; gently, as a share of the depth
FROM_M, GENTLY_FROM_M = -0.01, 0.0  # start of the press, before the surface
PRESSED_S, JERKED_S, JERK_S, AFTER_S, WINDOW_S, EASE_S, SLOW_S = 0.8, 1.2, 0.05, 0.2, 2.0, 0.7, 2.5
"""End of the press, start and length of the jerk, pause after it, length of each of two windows of rest, and then time
to ease into the slow motion, and its length [s]."""
SLOW_HZ: Final = (0.4, 1.2)
SLOW_SHARE: Final = (0.2, 0.1)
"""The slow motion: two sines with whole periods in `SLOW_S`, as shares of the press. Two, because stiffness and mass
cannot be told apart by one."""
PROBED_M: Final = (-0.02, 0.2)  # where the surface of a given scene is looked for
PROBE_M, PROBE_US = 0.05e-3, 10_000  # in these steps, slowly
WAIT_S: Final = 10.0  # longest wait for a session

Cell: TypeAlias = tuple[float | None, float]  # of a map: stiffness [N/m], None for a given scene; round trip [s]
LATE_TICKS: Final = 1
"""Ticks from a position to its force without any delay: it arrives after the tick, and is applied from the next on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """What all trials of a map share."""

    hand: HandSettings = HANDS["arm"]
    device: GroundedSettings = field(default_factory=GroundedSettings)
    master: MasterSettings = field(default_factory=MasterSettings)
    channel: ChannelSettings = field(default_factory=ChannelSettings)  # of each direction, apart from its delay
    scene: SceneSource | None = None  # what is pressed; None: walls
    seed: int = 0

    def scene_of(self, stiffness_n_per_m: float | None) -> Touchable:
        """Return a new wall, or the given scene; tissues do not break, so that the hand stays in contact."""
        if stiffness_n_per_m is not None:
            wall = Tissue(
                name="wall", rest_position_m=0.0, stiffness_n_per_m=stiffness_n_per_m, breach_force_n=LARGEST_VALUE
            )
            return Scene((wall,), name=f"wall of {stiffness_n_per_m:g} N/m")
        if self.scene is None:
            raise SettingsError("a press needs a stiffness or a scene")
        made = self.scene.make()
        if isinstance(settings := getattr(made, "settings", None), SceneSettings):
            whole = [replace(each, breach_force_n=LARGEST_VALUE) for each in settings.tissues]
            made = make_scene(replace(settings, tissues=tuple(whole)))
        if made.axes != 1:
            raise SettingsError(f"scene {made.name!r} has {made.axes} axes; a map presses on one axis")
        return made

    def expected(self, round_trip_s: float) -> Onset:
        """Return where the hand, without its reflex, begins to swing against a spring without codec or coupling."""
        hand, device, step_s = self.hand, self.device, 1.0 / self.master.rate_hz
        return sampled_onset(
            hand.mass_kg + device.mass_kg,
            hand.damping_n_s_per_m + device.damping_n_s_per_m,
            hand.stiffness_n_per_m,
            step_s,
            LATE_TICKS + math.floor(round_trip_s / step_s + 1e-9),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What happened in a trial."""

    stiffness_n_per_m: float | None  # of the wall; None for a given scene
    round_trip_s: float
    stable: bool  # whether the swing is small or decays, in position and force
    swing_m: float  # of the hand in the late window of rest, peak to peak
    swing_n: float
    largest_n: float  # largest force of the device on the hand
    created_j: float  # energy; see `EnergyReport`
    active_j: float
    # What the hand feels in the slow motion: stiffness, damping, mass; and the scene's. None if it is not stable.
    displayed: tuple[float, float, float] | None
    true: tuple[float, float, float] | None
    lag_s: float | None  # of the force behind the true one, in the slow motion
    position_error_m: float  # root mean square of the hand's position less the one that the slave has
    force_error_n: float  # root mean square of the applied force less the true one at the hand's position
    forward_packets: int
    feedback_packets: int
    forward_bytes: int  # on the wire, UDP and IPv4 headers included
    feedback_bytes: int
    failure: str | None  # why the session ended early

    @property
    def settles(self) -> bool:
        """Whether the hand still swings, but less and less."""
        return self.stable and self.swing_m > SMALL_SWING_M

    @property
    def stiffness_share(self) -> float | None:
        """Displayed stiffness over the true one."""
        return self.displayed[0] / self.true[0] if self.displayed and self.true and self.true[0] else None

    @property
    def transparent(self) -> bool:
        """Whether it is stable, and the displayed stiffness cannot be told from the true one."""
        share = self.stiffness_share
        return self.stable and share is not None and abs(share - 1.0) <= STIFFNESS_JND


class _Press:
    """The motion that the hand intends; see the module. Satisfies `Operator`."""

    def __init__(self, setup: Setup, at: tuple[float, float], force_n: float, delay_s: float, *, gentle: bool) -> None:
        hand, from_m = setup.hand, (GENTLY_FROM_M if gentle else FROM_M)
        self.axes = 1
        self._from_m = at[0] + from_m
        self._by_m = at[1] + force_n / hand.stiffness_n_per_m - from_m
        self._jerk_m = GENTLE_JERK * at[1] if gentle else JERK_M
        # Two windows that hold at least a period and a half of the hand by itself
        own_s = 2.0 * math.pi * math.sqrt((hand.mass_kg + setup.device.mass_kg) / hand.stiffness_n_per_m)
        self.window_s = max(WINDOW_S, 1.5 * own_s)
        if gentle:  # many round trips, because a swing grows once in each
            self.window_s = 1.2 * self.window_s + 10.0 * delay_s
        self.slow_s = JERKED_S + JERK_S + AFTER_S + delay_s + 2.0 * self.window_s
        self.measures_s = self.slow_s + EASE_S + delay_s
        self._amplitude_m = self._by_m + from_m
        self.duration_us: int | None = round(1e6 * (self.measures_s + SLOW_S))

    def sample(self, t_us: int) -> PositionSample:
        t_s = 1e-6 * t_us
        tau = min(t_s / PRESSED_S, 1.0)
        at_m = self._from_m + self._by_m * tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))  # minimum jerk
        if JERKED_S <= t_s < JERKED_S + JERK_S:
            at_m += 0.5 * self._jerk_m * (1.0 - math.cos(2.0 * math.pi * (t_s - JERKED_S) / JERK_S))
        if t_s > self.slow_s:
            for hz, share in zip(SLOW_HZ, SLOW_SHARE, strict=True):
                at_m += share * self._amplitude_m * math.sin(2.0 * math.pi * hz * (t_s - self.slow_s))
        return PositionSample(t_us, (at_m,))


class _Watched:
    """A hand on a device, its position and the force of the device in each tick. Satisfies `Operator`, with `feel`."""

    def __init__(self, hand: YieldingOperator) -> None:
        self._hand = hand
        self.axes, self.duration_us, self.capabilities = hand.axes, hand.duration_us, hand.capabilities
        self.feel = hand.feel
        self.t_us: list[int] = []
        self.at_m: list[float] = []
        self.pushed_n: list[float] = []

    def sample(self, t_us: int) -> PositionSample:
        sampled = self._hand.sample(t_us)
        self.t_us.append(t_us)
        self.at_m.append(sampled.position_m[0])
        self.pushed_n.append(self._hand.applied_n[0])
        return sampled


def press(setup: Setup, stiffness_n_per_m: float | None, round_trip_s: float, *, gentle: bool = False) -> Outcome:
    """Return the outcome of one trial.

    `gentle`: the hand meets the surface slowly, so that it stays in contact, rests for longer, and is not moved then;
    for the onset, which is that of the linear system.
    """
    touched, pressed_n = setup.scene_of(stiffness_n_per_m), min(PRESS_N, 0.6 * setup.device.max_force_n)
    at = (0.0, pressed_n / stiffness_n_per_m) if stiffness_n_per_m else _surface(setup.scene_of(None), pressed_n)
    motion = _Press(setup, at, pressed_n, round_trip_s, gentle=gentle)
    hand = _Watched(YieldingOperator(motion, setup.hand, setup.device))
    round_trip_us = round(1e6 * round_trip_s)
    link = emulated(
        hand,
        touched,
        replace(setup.master, record=True),
        forward=replace(setup.channel, delay_us=round_trip_us // 2),
        feedback=replace(setup.channel, delay_us=round_trip_us - round_trip_us // 2),
        seed=setup.seed,
    )
    ends_us = round(1e6 * (motion.slow_s if gentle else motion.measures_s + SLOW_S))
    while not link.master.finished and (not hand.t_us or hand.t_us[-1] < ends_us):
        link.run(20_000)
        if not hand.t_us and link.now_us > 1e6 * WAIT_S:
            raise SettingsError(
                f"no session begins within {WAIT_S:g} s over a round trip of {round_trip_s:g} s with"
                f" {setup.channel.describe()} each way: shorten the round trip, or reduce jitter and loss"
            )
    context = link.slave.contexts[-1]
    slave, master = (each.recording.table() if each.recording is not None else {} for each in (context, link.master))
    # What the hand says at a tick was applied since the tick before it.
    t_us, at_m, applied_n = np.array(hand.t_us[:-1]), np.array(hand.at_m[:-1]), np.array(hand.pushed_n[1:])
    t_s, law = 1e-6 * t_us, setup.master.law
    scene = setup.scene_of(stiffness_n_per_m)
    true_n = np.array([
        scene.step(PositionSample(int(at_us), (float(x),))).force_n[0] for at_us, x in zip(t_us, at_m, strict=True)
    ])  # fmt: skip

    end_s = min(motion.slow_s, float(t_s[-1]))
    early, late = (
        (t_s > end_s - number * motion.window_s) & (t_s <= end_s - (number - 1) * motion.window_s) for number in (2, 1)
    )
    stable, swings = link.master.failure is None and hand.t_us[-1] >= ends_us, []
    decays = GENTLY_DECAYS if gentle else DECAYS
    for values, small in (at_m, SMALL_SWING_M), (applied_n, SMALL_SWING_JND * law.jnd_n(pressed_n)):
        before, swing = (float(np.ptp(values[each])) if each.any() else 0.0 for each in (early, late))
        stable = stable and (swing <= small or (swing < decays * before and bool(np.all(true_n[late] > 0.0))))
        swings.append(swing)
    moving = (t_s > motion.measures_s) & (t_s <= motion.measures_s + SLOW_S)
    measurable = stable and not gentle and float(np.ptp(at_m[moving])) > 0.0
    now_us = t_us - hand.t_us[-1] + master["t_us"][-1]
    known = np.maximum(np.searchsorted(slave["answered_us"], now_us, "right") - 1, 0)
    energy = energy_report(law, true_n[:, None], applied_n[:, None], at_m[:, None])
    forward, feedback = link.master.session.sent, context.session.sent
    return Outcome(
        stiffness_n_per_m=stiffness_n_per_m,
        round_trip_s=round_trip_s,
        stable=stable,
        swing_m=swings[0],
        swing_n=swings[1],
        largest_n=float(np.abs(applied_n).max()),
        created_j=energy.created_j,
        active_j=energy.active_j,
        displayed=_impedance(t_s[moving], at_m[moving], applied_n[moving]) if measurable else None,
        true=_impedance(t_s[moving], at_m[moving], true_n[moving]) if measurable else None,
        lag_s=_lag_s(t_s[moving], true_n[moving], applied_n[moving]) if measurable else None,
        position_error_m=_rms(at_m - slave["position_m"][known]),
        force_error_n=_rms(applied_n - true_n),
        forward_packets=forward.packets,
        feedback_packets=feedback.packets,
        forward_bytes=forward.wire_bytes,
        feedback_bytes=feedback.wire_bytes,
        failure=link.master.failure,
    )


def _surface(scene: Touchable, force_n: float) -> tuple[float, float]:
    """Return where a scene's surface is [m], and how deep it must be pressed for a force."""
    surface_m = None
    for number, at_m in enumerate(np.arange(*PROBED_M, PROBE_M).tolist()):
        felt_n = scene.step(PositionSample(number * PROBE_US, (at_m,))).force_n[0]
        if surface_m is None and felt_n > 0.0:
            surface_m = at_m - PROBE_M
        if surface_m is not None and felt_n >= force_n:
            return surface_m, at_m - surface_m
    found = "has no surface" if surface_m is None else f"gives less than {force_n:g} N"
    raise SettingsError(f"scene {scene.name!r} {found} between {PROBED_M[0]:g} and {PROBED_M[1]:g} m")


def _amplitudes(t_s: FloatArray, values: FloatArray) -> list[complex]:
    """Return the complex amplitude of a signal at each frequency of the slow motion."""
    return [2.0 * complex(np.mean(values * np.exp(-2j * math.pi * hz * t_s))) for hz in SLOW_HZ]


def _impedance(t_s: FloatArray, at_m: FloatArray, force_n: FloatArray) -> tuple[float, float, float]:
    """Return the stiffness, damping and mass that explain a force by position, velocity and acceleration.

    By least squares, of the amplitudes at the frequencies of the motion, which noise does not disturb.
    """
    rows, wanted = [], []
    for hz, x, force in zip(SLOW_HZ, _amplitudes(t_s, at_m), _amplitudes(t_s, force_n), strict=True):
        omega = 2.0 * math.pi * hz
        each = (x, 1j * omega * x, -omega * omega * x)
        rows += [[part.real for part in each], [part.imag for part in each]]
        wanted += [force.real, force.imag]
    stiffness, damping, mass_kg = np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0].tolist()
    return stiffness, damping, mass_kg


def _lag_s(t_s: FloatArray, true_n: FloatArray, applied_n: FloatArray) -> float:
    true, applied = _amplitudes(t_s, true_n)[0], _amplitudes(t_s, applied_n)[0]
    turned = true * applied.conjugate()
    return math.atan2(turned.imag, turned.real) / (2.0 * math.pi * SLOW_HZ[0])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def outcomes(setup: Setup, cells: Sequence[Cell], *, jobs: int = 1) -> Iterator[Outcome]:
    """Yield the outcome of each press; they do not depend on the number of processes."""
    with workers(min(jobs, len(cells)), setup) as run:
        yield from run(_press, cells)


def _press(setup: Setup, cell: Cell) -> Outcome:
    return press(setup, *cell)


def word(found: Outcome) -> str:
    """Return what happened in one or two words: for a table, and for a map."""
    if not found.stable and found.swing_m <= SMALL_SWING_M:
        return f"{found.swing_n:.2g} N"
    if not found.stable:
        return f"{1e3 * found.swing_m:.3g} mm" if found.swing_m < THROWN_M else "thrown"
    share = found.stiffness_share
    felt = "" if found.transparent or share is None else f" {100.0 * share:.0f}%"
    return ("settles" if found.settles else "stable") + felt


def draw_map(file: Path, found: Sequence[Outcome], *, title: str) -> None:
    """Draw a map: how far the hand swings, by round trip and stiffness."""
    delays = sorted({each.round_trip_s for each in found})
    stiffnesses = sorted({each.stiffness_n_per_m or 0.0 for each in found})
    looks = {"stable": SKY, "stable, other stiffness": GREY, "swings for ever": VERMILION}
    with picture(file, 1.2 + 0.35 * len(stiffnesses)) as figure:
        axes = figure.subplots()
        for each in found:
            look = "swings for ever" if not each.stable else "stable" if each.transparent else "stable, other stiffness"
            at = delays.index(each.round_trip_s), stiffnesses.index(each.stiffness_n_per_m or 0.0)
            axes.bar(at[0], 0.94, 0.94, at[1] - 0.47, color=looks[look], alpha=0.75, label=look)
            axes.text(*at, word(each), ha="center", va="center", fontsize=7)
        axes.grid(visible=False)
        axes.set_xticks(range(len(delays)), [f"{1e3 * each:g}" for each in delays])
        axes.set_yticks(range(len(stiffnesses)), [f"{each:g}" if each else "scene" for each in stiffnesses])
        axes.set_xlabel("round trip [ms]")
        axes.set_ylabel("stiffness [N/m]")
        axes.set_title(title)
        legend(figure, axes)
