"""Time per step of the scene, over the number of layers and for each property that a tissue declares."""

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import record

from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import BodySceneSettings, Tissue
from hapticnet.scene.sources import find_scene, paper_scene

LAYERS = (3, 10, 100, 1_000, 10_000)
FEATURES: dict[str, dict[str, float]] = {
    "nothing more": {},
    "stiffening": {"stiffening_per_m": 50.0},
    "viscosity": {"viscosity_n_s_per_m": 1.0},
    "recovery": {"recovery_time_s": 0.5},
    "all three": {"stiffening_per_m": 50.0, "viscosity_n_s_per_m": 1.0, "recovery_time_s": 0.5},
}
FRICTIONS: dict[str, dict[str, float]] = {
    "nothing more": {},
    "friction": {"friction": 0.3},
    "friction and viscosity": {"friction": 0.3, "sliding_viscosity_n_s_per_m": 1.0},
}
GAP_M = 20e-3
PERIOD_US = 1_000
STEPS = 10_000


def layered(layers: int, **declared: float) -> Scene:
    """Return a scene of equal tissues that breach at half their gap, as the paper's do."""
    return Scene(
        [
            Tissue(
                name=f"tissue {number}",
                rest_position_m=number * GAP_M,
                stiffness_n_per_m=200.0,
                breach_force_n=2.0,
                **declared,
            )
            for number in range(1, layers + 1)
        ]
    )


def ns_per_step(
    scene: Scene | BodyScene, path_m: Sequence[float] | Sequence[Vector], repetitions: int
) -> dict[str, float]:
    """Walk `path_m` from the scene's front as often as asked and return the time per step [ns]."""
    samples = [
        PositionSample(k * PERIOD_US, at_m if isinstance(at_m, tuple) else (at_m,)) for k, at_m in enumerate(path_m)
    ]
    times_ns = []
    for _ in range(repetitions):
        scene.reset()
        step = scene.step
        step(samples[0])
        start_ns = time.perf_counter_ns()
        for sample in samples:
            step(sample)
        times_ns.append((time.perf_counter_ns() - start_ns) / len(samples))
    return {"median": statistics.median(times_ns), "best": min(times_ns)}


def in_contact_m(rng: np.random.Generator, layer: int) -> list[float]:
    """Return positions that press on one layer, with all before it penetrated, and do not breach it."""
    path_m: list[float] = (GAP_M * (layer + rng.uniform(0.05, 0.25, STEPS))).tolist()
    return path_m


def penetrated_m(rng: np.random.Generator, layer: int) -> list[float]:
    """Return positions between the place where one layer breaches and the next layer."""
    path_m: list[float] = (GAP_M * (layer + rng.uniform(0.75, 0.95, STEPS))).tolist()
    return path_m


def insertion_m(depth_m: float) -> list[float]:
    """Return positions of a steady push to `depth_m` and back."""
    way_in: list[float] = np.linspace(0.0, depth_m, STEPS // 2).tolist()
    return way_in + way_in[::-1]


def measure(arguments: argparse.Namespace) -> dict[str, dict[str, dict[str, float]]]:
    """Return the time per step [ns] of every case."""
    seed, repetitions = arguments.seed, arguments.repetitions
    rng = np.random.default_rng(seed)
    plain, rubbing = layered(3), layered(3, shaft_friction_n=0.2)
    one_penetrated_m = penetrated_m(rng, 1)
    return {
        "the paper's scene, whole insertions": {
            f"paper:{seed}": ns_per_step(Scene(paper_scene(seed).tissues), insertion_m(4 * GAP_M), repetitions)
        },
        "layers, in contact with the middle one": {
            str(layers): ns_per_step(layered(layers), in_contact_m(rng, (layers + 1) // 2), repetitions)
            for layers in LAYERS
        },
        "layers, each recovering": {
            str(layers): ns_per_step(
                layered(layers, recovery_time_s=0.5), in_contact_m(rng, (layers + 1) // 2), repetitions
            )
            for layers in LAYERS
        },
        "declared, in contact with one of 3": {
            name: ns_per_step(layered(3, **declared), in_contact_m(rng, 2), repetitions)
            for name, declared in FEATURES.items()
        },
        "declared, plane and sphere on three axes": {
            name: ns_per_step(bodies(**declared), touched_m(rng), repetitions) for name, declared in FRICTIONS.items()
        },
        "declared, 1 of 3 penetrated": {
            "nothing more": ns_per_step(plain, one_penetrated_m, repetitions),
            "shaft friction": ns_per_step(rubbing, one_penetrated_m, repetitions),
        },
    }


def touched_m(rng: np.random.Generator) -> list[Vector]:
    """Return positions that slide about on the phantom, pressing skin and lump."""
    path: list[list[float]] = ((0.027, 0.0, 0.0) + 1e-4 * rng.normal(size=(STEPS, 3)).cumsum(axis=0) % 2e-3).tolist()
    return [tuple(at_m) for at_m in path]


def bodies(**declared: float) -> BodyScene:
    """Return the phantom's plane and sphere with other friction and viscosity."""
    phantom = find_scene("phantom")
    assert isinstance(phantom, BodySceneSettings)
    nothing = {"friction": 0.0, "static_friction": 0.0, "sliding_viscosity_n_s_per_m": 0.0}
    return BodyScene([replace(body, **(nothing | declared)) for body in phantom.bodies])


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--repetitions", type=record.within(1), default=15, help=f"runs of {STEPS} steps per case")
    record.run(parser, measure, unit="ns per step")


if __name__ == "__main__":
    main()
