"""Token buckets: how often something may happen, with a reserve for bursts."""

import math
from collections import OrderedDict
from collections.abc import Hashable
from typing import Final

MOST_KEYS: Final = 4096
"""Keys remembered at once; the one unused for longest is forgotten."""


class TokenBucket:
    """A bucket of `depth` tokens that fills at `per_second`; each event takes one.

    The bucket is full at first.
    """

    __slots__ = ("_each_us", "_empty_us", "_full_us")

    def __init__(self, per_second: float, depth: float) -> None:
        self._each_us = 1e6 / per_second
        self._empty_us = depth * self._each_us
        self._full_us = -math.inf  # when the bucket is full again

    def take(self, now_us: int) -> bool:
        """Take a token; return whether there was one."""
        full_us = (self._full_us if self._full_us > now_us else now_us) + self._each_us
        if full_us - now_us > self._empty_us:
            if full_us - now_us > self._empty_us + self._each_us + 1.0:  # the clock went back: begin again, empty
                self._full_us = now_us + self._empty_us
            return False
        self._full_us = full_us
        return True


class Buckets:
    """One token bucket for each key, such as the host of an address. Memory is bounded."""

    __slots__ = ("_buckets", "_depth", "_most_keys", "_per_second")

    def __init__(self, per_second: float, depth: float, most_keys: int = MOST_KEYS) -> None:
        self._per_second = per_second
        self._depth = depth
        self._most_keys = most_keys
        self._buckets: OrderedDict[Hashable, TokenBucket] = OrderedDict()

    def take(self, key: Hashable, now_us: int) -> bool:
        """Take a token from the bucket of `key`; return whether there was one."""
        bucket = self._buckets.get(key)
        if bucket is None:
            bucket = self._buckets[key] = TokenBucket(self._per_second, self._depth)
            if len(self._buckets) > self._most_keys:
                self._buckets.popitem(last=False)
        else:
            self._buckets.move_to_end(key)
        return bucket.take(now_us)
