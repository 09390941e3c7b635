"""Masking noise at a terminal: white noise through a player of the system. On a page, the browser plays it."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Final

import numpy as np

from hapticnet.runtime.system import start_background

RATE_HZ: Final = 48_000
LOOP_S: Final = 10
LEVEL: Final = 0.1
"""Root mean square of the noise as a share of full scale; the volume is set at the headphones."""

PLAYERS: Final = (
    ("pacat", "--raw", "--format=s16le", f"--rate={RATE_HZ}", "--channels=1"),
    ("aplay", "-q", "-t", "raw", "-f", "S16_LE", "-r", str(RATE_HZ), "-c", "1", "-"),
    ("play", "-q", "-t", "raw", "-e", "signed", "-b", "16", "-r", str(RATE_HZ), "-c", "1", "-"),
)
"""Players that take samples from a pipe: of PulseAudio and PipeWire, of ALSA, of SoX."""


def samples() -> bytes:
    """Return white Gaussian noise, 16 bit, to be played again and again."""
    drawn = np.random.default_rng(1).normal(0.0, LEVEL * 32767.0, LOOP_S * RATE_HZ)
    return np.clip(drawn, -32767.0, 32767.0).astype("<i2").tobytes()


@contextmanager
def masking_noise(tell: Callable[[str], None]) -> Iterator[float]:
    """Play noise until the end of the context; yield its level, 0 if there is no player.

    Parameters
    ----------
    tell
        Called with a line for the experimenter if nothing can be played.
    """
    player = next((words for words in PLAYERS if shutil.which(words[0]) is not None), None)
    if player is None:
        names = ", ".join(words[0] for words in PLAYERS)
        tell(f"masking noise: none of {names} is installed; play white noise from another program")
        yield 0.0
        return
    process = subprocess.Popen(  # noqa: S603 - a fixed command
        player, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    start_background(partial(_feed, process, tell), "masking noise")
    try:
        yield LEVEL
    finally:
        process.kill()
        process.wait()


def _feed(process: "subprocess.Popen[bytes]", tell: Callable[[str], None]) -> None:
    """Write noise until the player ends; it takes no more than it plays."""
    noise, pipe = samples(), process.stdin
    assert pipe is not None  # noqa: S101 - it was asked for
    with suppress(OSError):
        while process.poll() is None:
            pipe.write(noise)
            pipe.flush()
    with suppress(OSError):
        pipe.close()
    if process.poll() not in (None, -9):
        tell("masking noise: the player ended; play white noise from another program")
