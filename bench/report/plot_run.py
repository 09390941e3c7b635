"""Draw a run for the README: the paper's scene at 1 JND with a simulated finger, in virtual time."""

import argparse
from pathlib import Path

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.experiment.signal_figure import draw_run
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

SEED = 1


def main() -> None:
    """Play the run and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="picture to write")
    rng = np.random.default_rng(SEED)
    scene = paper_scene(SEED)
    operator = ScriptedOperator(InsertionSettings(insertions=1), rng)
    link = Loopback(
        MasterNode(operator, SimulatedDevice(PlantSettings(), rng), MasterSettings(record=True), rng),
        SlaveNode(lambda _: Scene(scene.tissues, name=scene.name), SlaveSettings(record=True), rng),
        forward=Emulator(parse_channel("perfect"), rng),
        feedback=Emulator(parse_channel("perfect"), rng),
    )
    link.run(duration_us=operator.duration_us)
    (context,) = link.slave.contexts
    tables = context.recording.table(), link.master.recording.table()
    draw_run(*tables, parser.parse_args().file, codec="deadband, 1 JND")


if __name__ == "__main__":
    main()
