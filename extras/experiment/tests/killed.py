"""Kill sessions at random moments, and go on with them: ``python killed.py FOLDER KILLS SEED``.

Each session runs in a forked process with a table on disk, in turns of the ordering task and of the measurement of the
JND. The process writes down which rows were stored when it showed a screen.
"""

import asyncio
import os
import random
import signal
import sys
import time
from pathlib import Path

from conducted import DATE, SMALL, GivenRig, WillingFront

from hapticnet_experiment.session import SessionSettings, conduct, open_session
from hapticnet_experiment.tasks import LIMITS, ORDER

LONGEST_S = 0.06
WHILE_OPENING = 0.2
"""Longest time from the begin of a session to its kill, and the share of kills before it begins."""


class WitnessedFront(WillingFront):
    def __init__(self, rig, path, told):
        super().__init__(rig)
        self._path = path
        self._told = told

    async def show(self, flow):
        lines = [f"{row.event} {row.this_n}\n" for row in flow.rows[self._told :]]
        self._told = len(flow.rows)
        if lines:
            with self._path.open("a") as file:
                file.write("".join(lines))


def settings_of(folder: Path, number: int) -> SessionSettings:
    return SessionSettings(
        task=ORDER if number % 2 else LIMITS,
        participant=f"{number:02}",
        session=1,
        seed=3,
        plan=SMALL,
        out=folder,
        observer=None,
        device="given",
        resume=True,
    )


def run(folder: Path, number: int, begun: int | None = None) -> None:
    settings = settings_of(folder, number)
    rig = GivenRig()
    with open_session(settings, rig.now_us()) as (flow, store):
        front = WitnessedFront(rig, folder / f"witness-{number}", len(store.rows))
        if begun is not None:
            os.close(begun)
        asyncio.run(conduct(flow, rig, front, store, date=lambda: DATE))


def killed_after(folder: Path, number: int, seconds: float, *, opening: bool) -> bool:
    """Run a session for a while; return whether it had to be killed."""
    heard, begun = os.pipe()
    child = os.fork()
    if not child:
        status = 1
        try:
            run(folder, number, begun)
            status = 0
        finally:
            os._exit(status)
    os.close(begun)
    if not opening:
        os.read(heard, 1)  # it ends when the session has begun
    os.close(heard)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status):
        assert os.WEXITSTATUS(status) == 0, "the session failed"
    return os.WIFSIGNALED(status)


def main(folder: Path, kills: int, seed: int) -> None:
    rng = random.Random(seed)
    number, killed = 1, 0
    while killed < kills:
        if killed_after(folder, number, rng.uniform(0.0, LONGEST_S), opening=rng.random() < WHILE_OPENING):
            killed += 1
        else:
            number += 1
    run(folder, number)
    print(number)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
