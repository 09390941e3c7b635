"""Measure what README.md says: steps and copies, coupling against contact, and sessions over a network.

python extras/mujoco/measure.py
"""

import statistics
import time
from typing import Any

import numpy as np

import hapticnet as hn
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import InsertionSettings, PalpatingOperator, PalpationSettings, ScriptedOperator
from hapticnet.operator.yielding import HANDS, YieldingOperator
from hapticnet_mujoco import Scene

NETWORK = {"forward": "delay=50ms", "feedback": "delay=50ms"}
SETTLED = 500  # ticks after which the hand is felt


def pressing() -> Operator:
    """Return a hand that presses the block 12 mm deep."""
    return ScriptedOperator(InsertionSettings(approach_m=0.006, depth_m=0.022), np.random.default_rng(1))


def stroking(*surface_m: float) -> Operator:
    """Return a hand that presses and strokes around a point, along the first axis."""
    settings = PalpationSettings(surface_m=surface_m, inward=(1.0, 0.0, 0.0), palpations=3)
    return PalpatingOperator(settings, np.random.default_rng(2))


SCENES = {
    "block": (("tip", "-z"), pressing()),
    "drawer": (("finger", "yxz"), stroking(0.012, 0.0, 0.0)),
    "ball": (("finger", "-zxy"), stroking(0.012, 0.0, 0.0)),
    "table": (("finger", "-zxy"), stroking(0.05, 0.08, 0.0)),
    "arm": (("probe", "xyz"), stroking(0.02, 0.0, 0.0)),
}
SESSIONS: list[tuple[str, bool, str, dict[str, Any]]] = [
    ("block", False, "deadband", {}),
    ("block", False, "motion-predictive", {}),
    ("block", False, "deadband", {"predicted": True}),
    ("block", False, "motion-predictive", {"predicted": True}),
    ("block", True, "deadband", {}),
    ("block", True, "deadband", {"coupling": "energy-bounded"}),
    ("block", True, "motion-predictive", {}),
    ("table", True, "deadband", {}),
    ("table", True, "deadband", {"coupling": "energy-bounded"}),
    ("table", True, "motion-predictive", {"coupling": "energy-bounded"}),
    ("ball", True, "motion-predictive", {"coupling": "energy-bounded"}),
]


def scene(name: str, force: str = "coupling") -> Scene:
    """Return a new scene."""
    (tool, axes), _ = SCENES[name]
    return Scene("ball" if name == "table" else name, tool, axes, force=force)


def times(name: str) -> str:
    """Return the median times of a step and a copy, along the hand."""
    touched, hand = scene(name), SCENES[name][1]
    steps, copies, ahead = [], [], []
    for tick in range(4000):
        sample = hand.sample(1000 * tick)
        begun = time.perf_counter()
        touched.step(sample)
        stepped = time.perf_counter()
        other = touched.copy()
        copied = time.perf_counter()
        if tick % 20 == 0:
            other.step(hn.PositionSample(1000 * (tick + 100), sample.position_m))
            ahead.append(time.perf_counter() - copied)
        del other
        steps.append(stepped - begun)
        copies.append(copied - stepped)
    return (
        f"step {1e6 * statistics.median(steps):5.1f} µs, 99 % {1e6 * np.percentile(steps, 99):5.1f};"
        f" copy {1e6 * statistics.median(copies):4.1f}; 100 ms ahead {1e6 * statistics.median(ahead):4.0f}"
    )


def session(name: str, force: str, hand: Operator, **settings: Any) -> str:
    """Return what is felt in 10 s."""
    link = hn.virtual_link(scene=scene(name, force), operator=hand, **settings)
    link.run(seconds=10.0)
    report, samples = link.report(), link.slave_samples()
    true_n = np.stack([samples[each] for each in samples if each.startswith("force")], axis=1)[SETTLED:]
    kilobytes = (report.forward_wire_bytes + report.feedback_wire_bytes) / 1e4
    return (
        f"forces/s {report.sent / 10:5.1f}, {kilobytes:4.1f} kB/s, RMSE {report.felt_rmse_n:6.3f} N,"
        f" largest force {np.abs(true_n).max():6.1f} N, largest jump {np.abs(np.diff(true_n, axis=0)).max():6.1f} N"
    )


def main() -> None:
    """Print all of it."""
    for name in SCENES:
        print(f"{name:7}{times(name)}")
    for name, (_, hand) in SCENES.items():
        for force in ("coupling", "contact"):
            arm = YieldingOperator(hand, HANDS["arm"])
            print(f"{name:7}{force:9} scripted   {session(name, force, hand, codec='motion-predictive')}")
            print(f"{name:7}{force:9} arm, 100 ms {session(name, force, arm, codec='motion-predictive', **NETWORK)}")
    for name, yields, codec, more in SESSIONS:
        hand = YieldingOperator(SCENES[name][1], HANDS["arm"]) if yields else SCENES[name][1]
        said = session(name, "coupling", hand, codec=codec, **NETWORK, **more)
        print(f"{name:6}100 ms {'arm' if yields else 'scripted':9}{codec:18}{','.join(more):10}{said}")


if __name__ == "__main__":
    main()
