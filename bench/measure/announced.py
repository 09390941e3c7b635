"""What a hand feels in scenes that announce the contact ahead, correctly or wrongly.

Each run is a whole session in virtual time over a link with delay and loss in both directions. At each tick of the
master, the held force is compared with the force of the scene at that position.
"""

import argparse
import math
import multiprocessing
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import record

from hapticnet.arrays import FloatArray
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.measure.metrics import error_report
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample
from hapticnet.scene.ahead import LayerAhead
from hapticnet.scene.base import Touchable
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene

Row = dict[str, Any]

LAW: Final = WeberLaw()
PERIOD_US: Final = 1000
HAND: Final = InsertionSettings(insertions=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One session.

    Attributes
    ----------
    codec, announced, positions
        The codec, whether the scene announces the contact ahead, and which positions are sent.
    says
        How the announcement differs from the scene; "" if it does not.
    delay_ms, jitter_ms, loss
        In each direction. Jitter is normal and keeps the order.
    """

    scene: str = "paper:1"
    codec: str = "deadband"
    announced: bool = False
    positions: Literal["raw", "line"] = "raw"
    says: str = ""
    delay_ms: int = 50
    jitter_ms: int = 0
    loss: float = 0.0
    seed: int = 1


def stiffer(layer: LayerAhead, factor: float) -> LayerAhead:
    return layer._replace(stiffness_n_per_m=factor * layer.stiffness_n_per_m)


LIES: Final[dict[str, Callable[[LayerAhead], LayerAhead]]] = {
    "stiffness 2x": lambda layer: stiffer(layer, 2.0),
    "stiffness 0.5x": lambda layer: stiffer(layer, 0.5),
    "stiffness 1.1x": lambda layer: stiffer(layer, 1.1),
    "surface 1 mm deeper": lambda layer: layer._replace(surface_m=layer.surface_m + 1e-3),
    "surface 1 mm nearer": lambda layer: layer._replace(surface_m=layer.surface_m - 1e-3),
    "breach force 1.2x": lambda layer: layer._replace(breach_force_n=1.2 * layer.breach_force_n),
    "breach force 0.8x": lambda layer: layer._replace(breach_force_n=0.8 * layer.breach_force_n),
    "a wall of 1e6 N/m": lambda layer: layer._replace(stiffness_n_per_m=1e6, breach_force_n=math.inf),
    "a wall of 9 kN/m": lambda layer: layer._replace(stiffness_n_per_m=9e3, breach_force_n=math.inf),
    "nonsense": lambda layer: layer._replace(stiffness_n_per_m=-1.0, surface_m=math.nan),
    "nothing": lambda layer: layer._replace(surface_m=1e3),
}


class Says(Scene):
    """A scene with altered announcements."""

    lie: Callable[[LayerAhead], LayerAhead] | None = None

    def ahead(self) -> tuple[LayerAhead, ...]:
        layers = super().ahead()
        return layers if self.lie is None else tuple(map(self.lie, layers))


def run(case: Case) -> Row:
    """Return the felt error of a session."""
    settings = find_scene(case.scene)

    def make_scene(_: object) -> Touchable:
        scene = Says(settings.tissues, name=settings.name)
        scene.lie = LIES.get(case.says)
        return scene

    spec = f"delay={case.delay_ms}ms,loss={100 * case.loss}%"
    spec += f",jitter=normal:{case.jitter_ms}ms" if case.jitter_ms else ""
    forward, feedback = (
        Emulator[bytes](parse_channel(spec), np.random.default_rng([case.seed, side])) for side in (1, 2)
    )
    hand = ScriptedOperator(HAND, np.random.default_rng(case.seed))
    master = MasterNode(
        hand,
        None,
        MasterSettings(codec=case.codec, announced=case.announced, positions=case.positions, record=True),
        np.random.default_rng([case.seed, 3]),
    )
    slave = SlaveNode(make_scene, SlaveSettings(), np.random.default_rng([case.seed, 4]))
    link = Loopback(master, slave, forward=forward, feedback=feedback)
    on_model = []
    for _ in range((hand.duration_us + 4_000 * case.delay_ms + 500_000) // PERIOD_US):
        link.run(PERIOD_US)
        on_model.append(master.on_model)
    assert master.recording is not None
    table = master.recording.table()
    t_us, positions, held = table["t_us"], table["position_m"][:, None], table["held_n"][:, None]
    true = true_force(Scene(settings.tissues), t_us, positions)
    wrong = np.abs(true - held)[:, 0] > LAW.jnds_n(np.abs(held)[:, 0])
    report = error_report(LAW, true, held)
    return {
        **asdict(case),
        "felt_above_jnd": report.exceed_jnd_fraction,
        "felt_rmse_n": report.rmse_n,
        "longest_wrong_ms": longest_run(wrong),
        "longest_wrong_model_ms": longest_run(wrong & np.array(on_model)),
        "on_model": master.report()["ticks_on_model"] / len(t_us),
    }


def true_force(scene: Scene, t_us: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the force of a scene that sees every position of the master, shape (n, 1)."""
    samples = zip(t_us.tolist(), positions.tolist(), strict=True)
    return np.array([scene.step(PositionSample(int(t), tuple(x))).force_n for t, x in samples])


def longest_run(wrong: npt.NDArray[np.bool_]) -> int:
    """Return the longest run of wrong ticks."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wrong, [False]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def cases(arguments: argparse.Namespace) -> list[Case]:
    """Return the grid: links, codecs, wrong announcements."""
    ways = [("raw", False), ("deadband", False), ("adaptive-predictive", False), ("motion-predictive", False)]
    ways += [("deadband", True), ("motion-predictive", True)]
    links = [(0, 0, 0.0), (5, 0, 0.0), (25, 0, 0.0), (50, 0, 0.0), (100, 0, 0.0)]
    links += [(50, 0, 0.05), (50, 0, 0.1), (25, 5, 0.05), (100, 0, 0.05)]
    if arguments.quick:
        links = [(50, 0, 0.05)]
    grid = []
    for seed in range(arguments.seed, arguments.seed + arguments.seeds):
        base = Case(seed=seed, scene=f"paper:{seed}")
        for delay_ms, jitter_ms, loss in links:
            link = replace(base, delay_ms=delay_ms, jitter_ms=jitter_ms, loss=loss)
            grid += [replace(link, codec=codec, announced=announced) for codec, announced in ways]
        bad = replace(base, announced=True, loss=0.0)
        grid += [replace(bad, says=says, codec=codec) for says in LIES for codec in ("deadband", "motion-predictive")]
        for loss in (0.0, 0.05):
            grid += [replace(base, announced=on, positions="line", loss=loss) for on in (False, True)]
    return grid


KEY: Final = ("scene", "codec", "announced", "positions", "says", "delay_ms", "jitter_ms", "loss")


def averaged(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each case, averaged over the seeds, but with the longest run of all."""
    blocks: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        scene = row["scene"].partition(":")[0]
        blocks.setdefault((scene, *(row[key] for key in KEY[1:])), []).append(row)
    made = []
    for key, block in blocks.items():
        mean: Row = dict(zip(KEY, key, strict=True))
        for name, value in block[0].items():
            if name not in mean and name != "seed":
                values = [row[name] for row in block]
                mean[name] = None if value is None else max(values) if "longest" in name else float(np.mean(values))
        made.append(mean)
    return made


def measure(arguments: argparse.Namespace) -> list[Row]:
    """Run all cases and return the averages over the seeds."""
    with multiprocessing.Pool(min(2, os.cpu_count() or 1)) as pool:
        return averaged(pool.map(run, cases(arguments), chunksize=1))


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1), default=3, help="number of hands and of scenes")
    parser.add_argument("--quick", action="store_true", help="one link only, to try the benchmark")
    record.run(parser, measure, unit="as in each name; shares of ticks")


if __name__ == "__main__":
    main()
