"""Rows of the ordering task, made by simulated observers on exact cues: no chain is played."""

from itertools import permutations

import numpy as np

from hapticnet_experiment.observers import OBSERVERS, Look, Observer
from hapticnet_experiment.rows import OrderRow
from hapticnet_experiment.tasks import right_pairs

CONDITIONS = (("none", "raw", 0.0), ("1 JND", "deadband", 1.0), ("2 JND", "deadband", 2.0), ("4 JND", "deadband", 4.0))
FORCES_N = (2.0, 3.5, 5.0)


def look(tissue: int, peak_n: float, step: float = 0.0, updates: int = 10) -> Look:
    return Look(
        tissue=tissue,
        peak_n=peak_n,
        updates=updates,
        step=step,
    )


def rows(
    people: int = 8,
    trials: int = 10,
    *,
    observer: str = "step-masking",
    simulated: bool = True,
    conditions=CONDITIONS,
    seed: int = 1,
) -> list[OrderRow]:
    rng = np.random.default_rng(seed)
    orders = list(permutations(range(3)))
    found = []
    for person in range(1, people + 1):
        own = Observer(OBSERVERS[observer].of_participant(rng), rng)
        for block, (name, codec, multiplier) in enumerate(conditions):
            common = {"participant": f"{person:02}", "session": 1, "block": block, "condition": name}
            common["observer"] = observer if simulated else None
            contacts = []
            for repetition in range(trials):
                forces = [FORCES_N[each] for each in orders[repetition % 6]]
                contacts = [look(tissue, forces[tissue], 0.05 * multiplier) for tissue in range(3)]
                orders_told = np.argsort(forces).tolist(), own.order(contacts)
                true, answered = ("".join(str(each + 1) for each in order) for order in orders_told)
                pairs = right_pairs(true, answered)
                found.append(
                    OrderRow(
                        event="trial",
                        **common,
                        this_n=block * trials + repetition,
                        this_rep_n=repetition,
                        onset_s=10.0 * (block * trials + repetition),
                        duration_s=8.0,
                        codec=codec,
                        multiplier=multiplier,
                        weber_fraction=0.05,
                        floor_n=0.025,
                        order_true=true,
                        order_answered=answered,
                        correct=int(true == answered),
                        pairs_correct=pairs,
                        contact_to_answer_s=6.0 + own.takes_s(),
                        insertions=2,
                        penetrations=6,
                        **{f"peak_held_{each + 1}_n": forces[each] for each in range(3)},
                        **{f"peak_sensed_{each + 1}_n": 0.95 * forces[each] for each in range(3)},
                        peak_speed_m_per_s=0.03,
                        perceptual_error=0.01 + 0.025 * multiplier,
                        penetration_packets=3500 if codec == "raw" else round(350 / multiplier),
                        force_packets=9000,
                        wire_bytes=500_000,
                        penetration_bytes=200_000 if codec == "raw" else round(20_000 / multiplier),
                        seed=seed,
                    )
                )
            found.append(OrderRow(event="rating", **common, rating=own.rate(contacts)))
    return found
