"""Measure what README.md says: steps and copies, coupling against contact, and sessions over a network.

python extras/mujoco/measure.py            # everything, in about ten minutes
python extras/mujoco/measure.py tasks      # only what a hand feels of a drawer, a screw and a pad at 150 ms
"""

import statistics
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

import hapticnet as hn
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import InsertionSettings, PalpatingOperator, PalpationSettings, ScriptedOperator
from hapticnet.operator.yielding import HANDS, YieldingOperator
from hapticnet.parts import KINDS
from hapticnet.samples import PositionSample
from hapticnet_mujoco import Pose, Scene, Task

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


WAYS: list[tuple[str, dict[str, Any]]] = [
    ("deadband", {"codec": "deadband"}),
    ("motion-predictive", {"codec": "motion-predictive"}),
    ("deadband, predicted", {"codec": "deadband", "predicted": True}),
    ("motion-predictive, predicted", {"codec": "motion-predictive", "predicted": True}),
]
POSITIONS_HZ = 65.0
PLACES = {"force": slice(0, 3), "torque": slice(3, 6), "grip": slice(6, 7)}


def felt_of(model: str, hand: Task, loss: str = "", **settings: Any) -> tuple[float, dict[str, tuple[float, float]]]:
    """Return what a task takes at 75 ms each way [kB/s, both ways], and how much of it is felt truly.

    For each part: the share of ticks in which the force that the master applies is within one JND of that of a second
    scene without delay, at the same positions; and the same share of the ticks in which that force is above the
    smallest JND.
    """

    def bench() -> Pose:
        return Pose(model, "palm", point="tip", grip="opening", force="contact")

    channel = "delay=75ms" + (f",loss={loss}" if loss else "")
    link = hn.virtual_link(
        scene=bench(), operator=hand, forward=channel, feedback=channel, fastest_rate_hz=POSITIONS_HZ, **settings
    )
    seconds = 1e-6 * hand.duration_us
    link.run(seconds=seconds)
    report, ticks = link.report(), link.master_samples()
    columns = {
        kind: [ticks[each] for each in ticks if each.startswith(kind)] for kind in ("position", "rotation", "held")
    }
    positions = np.column_stack([*columns["position"], *columns["rotation"], ticks["opening_m"]])
    held = np.column_stack(columns["held"])
    begin = int(np.argmax(positions.any(axis=1)))  # of the session
    twin = bench()
    true = np.array([
        twin.step(PositionSample(int(t_us), tuple(position)))
        for t_us, position in zip(ticks["t_us"][begin:], positions[begin:].tolist(), strict=True)
    ])  # fmt: skip
    shares = {}
    for part, place in PLACES.items():
        weber, least = KINDS[part].weber_fraction, KINDS[part].floor
        size, error = (np.linalg.norm(each[SETTLED:, place], axis=1) for each in (true, held[begin:] - true))
        is_right = error <= np.maximum(weber * size, least)
        shares[part] = float(is_right.mean()), float(is_right[size > least].mean())
    return (report.forward_wire_bytes + report.feedback_wire_bytes) / seconds / 1e3, shares


def tasks() -> Iterator[str]:
    """Yield the lines of the table of tasks."""
    runs: list[tuple[str, str, str, dict[str, Any], Task]] = [
        *(("armbench", name, "", settings, Task()) for name, settings in WAYS),
        ("armbench", *WAYS[-1][:1], "2%", WAYS[-1][1], Task()),
        ("workbench", *WAYS[-1][:1], "", WAYS[-1][1], Task()),
        ("workbench", *WAYS[-1][:1], "2%", WAYS[-1][1], Task()),
        *(("armbench", f"{WAYS[-1][0]}, {task}", "", WAYS[-1][1], Task(task)) for task in ("drawer", "screw", "pad")),
        ("armbench", f"{WAYS[-1][0]}, no tremor", "", WAYS[-1][1], Task(tremor_m=0.0)),
    ]
    for model, name, loss, settings, hand in runs:
        kilobytes, shares = felt_of(model, hand, loss, **settings)
        felt = " | ".join(f"{100 * every:.1f} ({100 * felt:.1f})" for every, felt in shares.values())
        yield f"| {model} | {name} | {loss or '0'} | {kilobytes:.1f} | {felt} |"


def main() -> None:
    """Print all of it, or only the tasks."""
    for line in tasks():
        print(line, flush=True)
    if sys.argv[1:] == ["tasks"]:
        return
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
