"""What the parent of a slave's workers shows to other programs."""

from collections.abc import Callable, Mapping
from typing import Any

from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.metrics import Metrics
from hapticnet.runtime.systemd import Notifier
from hapticnet.runtime.udp import HostPort
from hapticnet.runtime.workers.crew import Supervisor
from hapticnet.runtime.workers.merge import merged_distributions, merged_values, status


class WorkersMetrics(Metrics[Any]):
    """The metrics of all workers together. While one of them is stuck there is no news, so ``/health`` fails."""

    role = "workers"

    def __init__(self, supervisor: Supervisor, address: HostPort, tell: Callable[[str], None]) -> None:
        super().__init__(address, tell)
        self._supervisor = supervisor

    def check(self, now_us: int) -> None:
        """Send the present values."""
        if not self._supervisor.stuck():
            super().check(now_us)

    def values(self) -> dict[str, Any]:
        """Return the present values by name."""
        return merged_values(self._supervisor.workers)

    def distributions(self) -> Mapping[str, Distribution | None]:
        """Return the distributions [µs] by name."""
        return merged_distributions(self._supervisor.workers)


class WorkersNotifier(Notifier[Any]):
    """Tell systemd that all workers serve; not while one of them is stuck."""

    def __init__(self, supervisor: Supervisor, path: str) -> None:
        super().__init__(path, lambda: status(supervisor.workers))
        self._supervisor = supervisor

    def check(self, now_us: int) -> None:
        """Tell that the loops run."""
        if not self._supervisor.stuck():
            super().check(now_us)
