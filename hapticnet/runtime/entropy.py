"""Session numbers and nonces come from the operating system, so that no observer can compute the next one."""

import secrets


class SystemEntropy:
    """The operating system's random numbers. Satisfies `protocol.settings.Entropy`."""

    def integers(self, low: int, high: int, /) -> int:
        """Return a whole number from `low` to `high` - 1."""
        return low + secrets.randbelow(high - low)
