"""A rate limit. It imports nothing, because the log of every command uses it."""

import math


class TokenBucket:
    """A bucket of `depth` tokens, full at first, that fills at `per_second`; each event takes some."""

    def __init__(self, per_second: float, depth: float) -> None:
        self._each_us = 1e6 / per_second
        self._empty_us = depth * self._each_us
        self._full_us = -math.inf  # when the bucket is full again

    def take(self, now_us: int, tokens: float = 1.0) -> bool:
        """Take tokens; return whether they were available."""
        takes_us = tokens * self._each_us
        full_us = (self._full_us if self._full_us > now_us else now_us) + takes_us
        if full_us - now_us > self._empty_us:
            if full_us - now_us > self._empty_us + takes_us + 1.0:  # the clock went back: begin again, empty
                self._full_us = now_us + self._empty_us
            return False
        self._full_us = full_us
        return True
