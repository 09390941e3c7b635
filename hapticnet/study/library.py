"""What each condition lets a finger feel: trials played through the chain once, for many simulated answers."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.limits import LimitSettings
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.errors import UnavailableError
from hapticnet.experiment.workers import workers
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.master_settings import MasterSettings
from hapticnet.study.cues import Look
from hapticnet.study.hand import scripted_hand
from hapticnet.study.observers import CUE_FIELDS, Cue
from hapticnet.study.plan import ConditionPlan, Plan, law_of
from hapticnet.study.rig import Fault, MakeHand, Meet, Play, VirtualRig
from hapticnet.study.simulated_front import contacts
from hapticnet.study.trial import Played, Stimulus


@dataclass(frozen=True, slots=True, kw_only=True)
class Felt:
    """What was felt in the trials of one condition, tissues from softest to hardest. Arrays have shape (trials, 3).

    Attributes
    ----------
    cues
        Mean of each cue over the contacts of a trial.
    updates, steps, counts
        Mean number of updates and mean step of a contact, and number of contacts.
    bytes_per_penetration
        Mean bytes from the touch of a tissue to its breach.
    """

    condition: str
    multiplier: float
    cues: dict[Cue, FloatArray]
    updates: FloatArray
    steps: FloatArray
    counts: FloatArray
    bytes_per_penetration: float


def play_library(
    plan: Plan,
    *,
    motions: int = 3,
    seed: int = 1,
    jobs: int = 1,
    make_hand: MakeHand = scripted_hand,
    on_trial: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[Felt]:
    """Play every order of the tissues under every condition of a plan, in virtual time.

    Parameters
    ----------
    motions
        Motions of the hand for each order.
    jobs
        Processes; the result does not depend on it.
    on_trial
        Called with the number of trials played and of all.

    Raises
    ------
    UnavailableError
        If a trial cannot be played.
    """
    orders = list(permutations(plan.order.breach_forces_n))
    tasks = [
        (condition, forces_n, seed + 1000 * motion + order)
        for condition in plan.condition
        for order, forces_n in enumerate(orders)
        for motion in range(motions)
    ]
    played: list[tuple[list[Look], float]] = []
    with workers(jobs, (plan, make_hand)) as run:
        for each in run(_play, tasks):
            played.append(each)
            on_trial(len(played), len(tasks))
    own = len(orders) * motions
    return [
        _felt(condition, tasks[index * own : (index + 1) * own], played[index * own : (index + 1) * own])
        for index, condition in enumerate(plan.condition)
    ]


Task = tuple[ConditionPlan, tuple[float, ...], int]


def _play(shared: tuple[Plan, MakeHand], task: Task) -> tuple[list[Look], float]:
    (plan, make_hand), (condition, forces_n, seed) = shared, task
    stimulus = Stimulus(
        number=1,
        breach_forces_n=forces_n,
        gap_m=plan.order.gap_m,
        codec=condition.codec,
        law=law_of(condition, plan.jnd.weber_fraction, plan.jnd.floor_n),
        rate_hz=plan.link.rate_hz,
        forward=plan.link.forward,
        feedback=plan.link.feedback,
        seed=seed,
        limit_s=plan.order.time_limit_s,
    )
    outcome = play_trial(stimulus, make_hand=make_hand)
    measures = outcome.measures
    return contacts(outcome), measures.penetration_bytes / max(measures.penetrations, 1)


def play_trial(stimulus: Stimulus, *, make_hand: MakeHand = scripted_hand) -> Played:
    """Play one trial through the chain in virtual time, with a device that has just met the finger.

    Raises
    ------
    UnavailableError
        If it cannot be played.
    """
    device = SimulatedDevice(PlantSettings(), np.random.default_rng([stimulus.seed, 9]))
    rig = VirtualRig(Fingertip(device, LimitSettings(), ForceControlSettings()), MasterSettings(), make_hand=make_hand)
    for activity in (Meet(), Play(stimulus)):
        outcome = asyncio.run(rig.run(activity))
        if isinstance(outcome, Fault):
            raise UnavailableError(f"a simulated trial with {stimulus.codec} failed: {outcome.reason}")
    if not isinstance(outcome, Played):
        raise UnavailableError(f"a simulated trial with {stimulus.codec} was not played")
    return outcome


def _felt(condition: ConditionPlan, tasks: Sequence[Task], played: Sequence[tuple[list[Look], float]]) -> Felt:
    def table(field: str) -> FloatArray:
        rows = []
        for (_, forces_n, _), (felt, _) in zip(tasks, played, strict=True):
            ranked = sorted(range(len(forces_n)), key=forces_n.__getitem__)
            own = [[getattr(look, field) for look in felt if look.tissue == tissue] for tissue in ranked]
            rows.append([float(np.mean(values)) if values else 0.0 for values in own])
        return np.array(rows)

    counts = [
        [
            sum(look.tissue == tissue for look in felt)
            for tissue in sorted(range(len(forces_n)), key=forces_n.__getitem__)
        ]
        for (_, forces_n, _), (felt, _) in zip(tasks, played, strict=True)
    ]
    return Felt(
        condition=condition.name,
        multiplier=condition.threshold,
        cues={cue: table(field) for cue, field in CUE_FIELDS.items()},
        updates=table("updates"),
        steps=table("step"),
        counts=np.array(counts, dtype=np.float64),
        bytes_per_penetration=float(np.mean([spent for _, spent in played])),
    )
