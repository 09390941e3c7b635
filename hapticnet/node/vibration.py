"""Both ends of vibration beside force: the frames that a slave sends, and those that a master plays."""

from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np

from hapticnet.codec.vibration import FRAME, FRAME_US, LARGEST_M_S2, RATE_HZ, VibrationCodec
from hapticnet.errors import UserCodeError
from hapticnet.node.recording import VIBRATION_COLUMNS, Recording
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.scene.base import Vibrate

SAVED_S: Final = 0.5  # seconds of the budget that can be saved up
COARSER: Final = 2  # half octaves by which the quantiser gets coarser while the budget is short
COARSEST: Final = 12
MOST_BEHIND_US: Final = 5 * FRAME_US
"""After a longer gap between positions, what vibrated meanwhile is left out."""


class VibrationSender:
    """Ask a scene for its vibration, frame by frame, and send what is felt within the budget.

    `vibrate` is the scene's method; `budget` is in bytes per second, `threshold_m_s2` that of the person.
    """

    def __init__(self, vibrate: Vibrate, session: SlaveSession, budget: float, threshold_m_s2: float) -> None:
        self._vibrate = vibrate
        self._session = session
        self._codec = VibrationCodec(threshold_m_s2)
        self._bucket = TokenBucket(budget, SAVED_S * budget)
        self._before: bytes | None = None  # the frame before the next one; None if it was not sent
        self._next_us: int | None = None  # where the next frame begins, on the master's clock
        self._other_bytes = 0  # of a datagram without its frames, as the newest one had them
        self.frames = self.coarser = self.dropped = 0

    def datagrams(self, t_us: int, shift_us: int, now_us: int) -> list[bytes]:
        """Return the datagrams of the frames that have ended at `t_us` on the master's clock.

        `shift_us`: the scene's time minus that. Raise UserCodeError if the scene returns no frame.
        """
        if self._next_us is None or not 0 <= t_us - self._next_us <= MOST_BEHIND_US:
            self._next_us, self._before = t_us, None
        made = []
        while self._next_us + FRAME_US <= t_us:
            samples = self._vibrate(self._next_us + shift_us, FRAME, RATE_HZ)
            # A frame takes a fifth of its datagram: during loss, the next one repeats it for little.
            before = self._before if self._session.repair.is_lossy else None
            payload = None if samples is None else self._fitting(_checked(samples), before, now_us)
            if payload is not None:
                made.append(self._session.vibration(self._next_us, payload, before, now_us))
                self._other_bytes = len(made[-1]) - len(payload) - len(before or b"")
            self._before = payload
            self._next_us += FRAME_US
        return made

    def report(self) -> dict[str, int]:
        """Return how many frames were sent, how many of these coarser than they should be, and how many dropped."""
        return {"frames": self.frames, "coarser": self.coarser, "dropped": self.dropped}

    def _fitting(self, samples: list[float], before: bytes | None, now_us: int) -> bytes | None:
        """Return the finest payload that the budget allows; None if nothing is felt, or there is no budget for it."""
        for coarser in range(0, COARSEST + 1, COARSER):
            payload = self._codec.encode(samples, coarser=coarser)
            if payload is None:
                self.dropped += coarser > 0
                return None
            if self._bucket.take(now_us, float(self._other_bytes + len(payload) + len(before or b""))):
                self.frames += 1
                self.coarser += coarser > 0
                return payload
        self.dropped += 1
        return None


def _checked(samples: Sequence[float]) -> list[float]:
    """Return a scene's frame within the codec's range; raise UserCodeError if it is none."""
    try:
        frame = np.asarray(samples, dtype=np.float64)
    except (TypeError, ValueError):
        frame = np.empty(0)
    if frame.shape != (FRAME,) or not np.isfinite(frame).all():
        raise UserCodeError(f"vibration must return {FRAME} finite accelerations [m/s²], or None")
    clipped: list[float] = np.clip(frame, -LARGEST_M_S2, LARGEST_M_S2).tolist()
    return clipped


class Shaker(Protocol):
    """What renders vibration to a hand."""

    def vibrate(self, samples: Sequence[float], rate_hz: float, /) -> None:
        """Play accelerations [m/s²], which follow those of the call before; between calls nothing is asked for."""


MOST_WAITING: Final = 16  # frames that wait to be played
MOST_FRAMES_HZ: Final = 200.0  # frames that are read: twice as many as a slave sends
FADE: Final = 0.75  # share of a sample that the next one keeps where no frame is at hand: a third after 1.4 ms
RISE: Final = (0.25, 0.5, 0.75)  # shares of the first samples after that
SILENT_M_S2: Final = 1e-3  # below this, a fade has ended
ADOPTED_US: Final = 30_000  # a frame that is later than this costs itself; three in a row are waited for from then on
SETTLED_US: Final = 200_000  # after this silence the wait becomes shorter, by part of what is too much
SETTLED_PART: Final = 8
SPARE_FRAMES: Final = 100  # if so many waited for longer than a frame, one is left out and the others wait less
_SAMPLE_US: Final = 1e6 / RATE_HZ


class VibrationPlayer:
    """Play frames in their order and spacing on a shaker, a few samples in each tick.

    The first frame is played when it arrives. If a later one has waited longer on its way, it is played at once and
    those after it wait as long, so that an uneven network costs one gap, not many. Where no frame is at hand, because
    it was lost or nothing is felt, the last sample fades: nothing is repeated, so nothing buzzes.
    """

    def __init__(self, shaker: Shaker, threshold_m_s2: float, *, record: bool) -> None:
        self._shaker = shaker
        self._codec = VibrationCodec(threshold_m_s2)
        self._waiting: list[tuple[int, list[float]]] = []  # times at the slave [µs] and samples of frames, oldest first
        self._policed = TokenBucket(MOST_FRAMES_HZ, float(MOST_WAITING))
        self._wait_us = 0  # from the time of a frame until it is played
        self._heard_us = 0
        self._late_in_a_row = 0
        self._spare_us: list[int] = []  # how much earlier than needed the newest frames came
        self._frame: list[float] = []  # the frame that is played
        self._at = 0  # its next sample
        self._end_us = 0  # when it ends, at the slave
        self._rise: list[float] = []
        self._last_m_s2 = 0.0
        self._due_us = -1.0  # when the next sample is to be played; below 0: none is
        self.played_m_s2: list[float] = []  # samples of the newest tick; empty while nothing is felt
        self.frames = self.late = 0
        self.recording = Recording(VIBRATION_COLUMNS) if record else None

    def receive(self, t_us: int, payload: bytes, before: bytes | None, now_us: int) -> None:
        """Take a frame that begins at `t_us`, and the one before it if it is missing; PeerError if one is malformed."""
        if not self._policed.take(now_us):  # before it costs time
            self.late += 1
            return
        earlier_us = t_us - FRAME_US
        if before is not None and earlier_us >= self._end_us and all(at_us != earlier_us for at_us, _ in self._waiting):
            self._take(earlier_us, before, now_us)
        self._take(t_us, payload, now_us)

    def _take(self, t_us: int, payload: bytes, now_us: int) -> None:
        samples: list[float] = self._codec.decode(payload).tolist()
        waits_us = now_us - t_us
        over_us = waits_us - self._wait_us
        if self.frames and over_us > ADOPTED_US:
            self._late_in_a_row += 1
        else:
            self._late_in_a_row = 0
        if t_us < self._end_us or 0 < self._late_in_a_row < 3:
            self.late += 1
            return
        if over_us > 0:
            self._wait_us = waits_us
        elif now_us - self._heard_us > SETTLED_US:
            self._wait_us += over_us // SETTLED_PART
        self._spare_us.append(max(-over_us, 0))
        if len(self._spare_us) == SPARE_FRAMES:
            self._wait_us -= FRAME_US * (min(self._spare_us) > FRAME_US)
            self._spare_us.clear()
        self._heard_us = now_us
        self._waiting.append((t_us, samples))
        self._waiting.sort()
        if len(self._waiting) > MOST_WAITING:  # otherwise every frame would be left out before its turn
            del self._waiting[0]
            self._wait_us -= FRAME_US
        self.frames += 1

    def drive(self, now_us: int, *, mute: bool) -> None:
        """Play the samples that are due; `mute`: frames are dropped, and what is played fades."""
        if mute:
            self._waiting.clear()
            self._frame = []
        if not (self._waiting or self._at < len(self._frame) or self._last_m_s2):
            self.played_m_s2 = []
            self._due_us = -1.0
            return
        if self._due_us < 0.0 or abs(now_us - self._due_us) > MOST_BEHIND_US:  # it begins, or the clock leapt
            self._due_us = float(now_us)
        made = []
        while self._due_us <= now_us:
            made.append(self._next())
            self._due_us += _SAMPLE_US
        self.played_m_s2 = made
        if made:  # two ticks may follow each other within a sample, after a late one
            self._shaker.vibrate(made, float(RATE_HZ))
        if self.recording is not None:
            felt = getattr(self._shaker, "moved_m_s2", made)
            for at, played in enumerate(made):
                self.recording.add((self._due_us - (len(made) - at) * _SAMPLE_US, played, felt[at]))

    def report(self) -> dict[str, float]:
        """Return how many frames were taken and how many came too late, and how long they wait [ms]."""
        return {"frames": self.frames, "late": self.late, "wait_ms": self._wait_us / 1e3}

    def _next(self) -> float:
        """Return the next sample."""
        if self._at >= len(self._frame) and self._waiting:
            while len(self._waiting) > 1 and self._waiting[1][0] + self._wait_us <= self._due_us:
                del self._waiting[0]  # the wait has become shorter
            t_us, samples = self._waiting[0]
            if t_us + self._wait_us <= self._due_us + 0.5 * _SAMPLE_US:
                del self._waiting[0]
                follows = self._frame and t_us == self._end_us
                self._rise = [] if follows else list(RISE)
                self._frame, self._at, self._end_us = samples, 0, t_us + FRAME_US
        if self._at < len(self._frame):
            self._last_m_s2 = self._frame[self._at] * (self._rise.pop(0) if self._rise else 1.0)
            self._at += 1
        else:
            self._frame = []  # what comes next rises
            self._last_m_s2 *= FADE
            if abs(self._last_m_s2) < SILENT_M_S2:
                self._last_m_s2 = 0.0
        return self._last_m_s2
