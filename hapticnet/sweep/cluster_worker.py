"""What runs in a worker of a Dask cluster."""

import threading
from typing import Any, Final

from distributed import WorkerPlugin

from hapticnet.errors import SettingsError
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.pool import Computed
from hapticnet.sweep.runs import Plan, Runner
from hapticnet.sweep.table import versions
from hapticnet.sweep.work import compute

_plans: Final[dict[str, Plan]] = {}
_own = threading.local()


class Keeper(WorkerPlugin):
    """Keeps a plan in every worker, also in those that come later or are started again."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def setup(self, worker: Any) -> None:  # noqa: ARG002
        """Keep the plan."""
        _plans[self._plan.digest] = self._plan

    def teardown(self, worker: Any) -> None:  # noqa: ARG002
        """Forget it."""
        _plans.pop(self._plan.digest, None)


def compute_here(digest: str, first: int, end: int, hapticnet: str) -> Computed:
    """Return a shard, computed in this worker.

    Raises
    ------
    SettingsError
        If this worker has another hapticnet than the machine that asks.
    """
    if versions()["hapticnet"] != hapticnet:
        raise SettingsError(
            f"a worker has hapticnet {versions()['hapticnet']} and this machine {hapticnet}; install the same on all"
        )
    plan = _plans[digest]
    return compute(plan, _runner_of(plan), Shard(first, end))


def _runner_of(plan: Plan) -> Runner:
    """Return the runner of this thread: a worker may have several threads, and a runner is not made for them."""
    if getattr(_own, "digest", None) != plan.digest:
        _own.digest, _own.runner = plan.digest, plan.runner()
    runner: Runner = _own.runner
    return runner
