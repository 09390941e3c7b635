"""What each condition lets a finger feel: trials played through the chain once, for many simulated answers."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TypeAlias

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import LimitSettings
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.errors import UnavailableError
from hapticnet.experiment.workers import workers
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw
from hapticnet.study.hand import scripted_hand
from hapticnet.study.observers import CUE_FIELDS, Cue, Look, contacts
from hapticnet.study.plan import ConditionPlan, Plan
from hapticnet.study.rig import Fault, MakeHand, Meet, Play, VirtualRig
from hapticnet.study.trial import Played, Stimulus, stimulus_of

Task: TypeAlias = tuple[ConditionPlan, tuple[float, ...], int]
"""A trial to play: condition, breach forces [N] front to back, and seed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Felt:
    """What was felt in the trials of one condition, tissues from softest to hardest. Arrays have shape (trials, 3)."""

    condition: str
    multiplier: float
    cues: dict[Cue, FloatArray]  # mean of each cue over the contacts of a trial
    updates: FloatArray  # mean number of updates, and mean step, of a contact
    steps: FloatArray
    counts: FloatArray  # number of contacts
    bytes_per_penetration: float  # mean, from the touch of a tissue to its breach


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


def _play(shared: tuple[Plan, MakeHand], task: Task) -> tuple[list[Look], float]:
    (plan, make_hand), (condition, forces_n, seed) = shared, task
    law = WeberLaw(weber_fraction=plan.jnd.weber_fraction, floor_n=plan.jnd.floor_n)
    stimulus = stimulus_of(plan, condition, law, number=1, breach_forces_n=forces_n, seed=seed)
    outcome = play_trial(stimulus, make_hand=make_hand)
    return contacts(outcome), outcome.measures.penetration_bytes / max(outcome.measures.penetrations, 1)


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
    # For each trial, the contacts with each tissue, softest first.
    ranked = [
        [[look for look in felt if look.tissue == tissue] for tissue in sorted(range(3), key=forces_n.__getitem__)]
        for (_, forces_n, _), (felt, _) in zip(tasks, played, strict=True)
    ]

    def means(field: str) -> FloatArray:
        return np.array(
            [[float(np.mean([getattr(look, field) for look in own])) if own else 0.0 for own in row] for row in ranked]
        )

    return Felt(
        condition=condition.name,
        multiplier=condition.threshold,
        cues={cue: means(field) for cue, field in CUE_FIELDS.items()},
        updates=means("updates"),
        steps=means("step"),
        counts=np.array([[len(own) for own in row] for row in ranked], dtype=np.float64),
        bytes_per_penetration=float(np.mean([spent for _, spent in played])),
    )
