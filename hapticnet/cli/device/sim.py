"""``hapticnet device sim``: run a simulated device on a pseudo-terminal."""

from pathlib import Path
from typing import Annotated

import typer

from hapticnet import options


def sim(
    link: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Make a symbolic link to the pseudo-terminal at FILE.")
    ] = None,
    stiffness: Annotated[
        float, typer.Option(metavar="N/MM", help="Stiffness of the simulated finger at 1 N [N/mm].")
    ] = 1.0,
    seed: options.Seed = 0,
    duration: Annotated[float | None, typer.Option(min=0.0, help="Stop after this many seconds.")] = None,
) -> None:
    """Run the compiled firmware with simulated servos, finger and sensor on a pseudo-terminal.

    Prints the terminal's path on stdout and runs in real time until Ctrl-C, SIGTERM or --duration. Any program can open
    it like a serial port: hapticnet master --device serial:PATH. Build the simulator first: `make simulator`.
    """
    from contextlib import closing

    import numpy as np

    from hapticnet.cli.console import Console
    from hapticnet.device.simulated import Finger, PlantSettings
    from hapticnet.runtime.nano import Board
    from hapticnet.runtime.nano_pty import NanoPty, run_nano_pty
    from hapticnet.runtime.system import run

    settings = PlantSettings(finger=Finger(stiffness_n_m=1000.0 * stiffness))
    console = Console("sim", real_time=True)
    with closing(Board(settings, np.random.default_rng(seed))) as board, closing(NanoPty(board, link=link)) as nano:
        plant = board.plant

        def on_status() -> None:
            visitor = "in use" if nano.visited else "not in use"
            console.status(
                f"{visitor}; platform at {1e3 * plant.displacement_m:.2f} mm, {plant.contact_force_n:.2f} N; "
                f"{board.resets} resets, {nano.lost_us // 1000} ms skipped after stalls"
            )

        print(nano.path, flush=True)
        console.say(f"listening on {link or nano.path}, finger of {stiffness:g} N/mm")
        run(run_nano_pty(nano, duration_s=duration, on_status=on_status))
    console.finish()
    console.say(f"ended; {board.resets} resets, {nano.lost_us // 1000} ms skipped after stalls")
