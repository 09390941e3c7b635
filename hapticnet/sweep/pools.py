"""Workers that compute shards: processes on this machine, or those of a Dask cluster."""

import logging
import pickle
import queue
import threading
import time
import uuid
import warnings
from contextlib import suppress
from typing import Any, Final, TypeAlias

from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.experiment.workers import IN_HAND, EndedError, Outcome, Pool
from hapticnet.sweep.plan import Plan, Runner
from hapticnet.sweep.runs import Shard
from hapticnet.sweep.store import Computed, compute, versions

NEEDS: Final = "--scheduler needs Dask's distributed (extra cluster): pip install distributed"
CONNECT_S: Final = 10.0  # time [s] in which a scheduler must answer
COUNT_S: Final = 2.0  # time [s] between two counts of the workers
CLOSE_S: Final = 3.0
_own = threading.local()


def compute_here(plan: Plan, shard: tuple[int, int]) -> Computed:
    """Return a shard. A worker may have several threads, but each runner belongs to one thread."""
    if getattr(_own, "digest", None) != plan.digest:
        _own.digest, _own.runner = plan.digest, Runner(plan)
    runner: Runner = _own.runner
    return compute(plan, runner, Shard(*shard))


def local_pool(plan: Plan, workers: int) -> Pool:
    """Return processes on this machine; SettingsError if their number is out of range."""
    return Pool(workers, compute_here, plan, method="spawn")  # because the progress bar and Arrow may run threads


class ClusterPool:
    """Workers of the Dask scheduler at tcp://HOST:PORT, which return shards as bytes; or UnavailableError."""

    def __init__(self, plan: Plan, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise UnavailableError(NEEDS) from error
        for name in ("distributed", "tornado"):  # their messages repeat events that are handled here
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        self._address, self._killed = address, KilledWorker
        self._futures: dict[Shard, Any] = {}
        self._done: queue.SimpleQueue[tuple[Shard, Any]] = queue.SimpleQueue()
        self.workers = 0  # number of threads of all workers
        self._counted_s = -COUNT_S
        try:
            make_client: Any = Client
            self._client = make_client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:
            raise UnavailableError(f"no Dask scheduler answers at {address}") from error
        # The plan is the result of a task, so a worker without it fetches it, even after another was killed.
        key = f"hapticnet-{plan.digest[:12]}-{uuid.uuid4().hex}"
        with warnings.catch_warnings(action="ignore"):  # Dask's warning about a large plan
            self._plan = self._client.submit(pickle.loads, pickle.dumps(plan), key=key, pure=False)
        self._count()

    @property
    def in_hand(self) -> int:
        """Number of submitted shards that it has not returned."""
        return len(self._futures)

    @property
    def room(self) -> int:
        """Number of further shards to submit now. Without workers they wait at the scheduler."""
        return IN_HAND * max(self.workers, 1) - self.in_hand

    def submit(self, item: Shard) -> None:
        """Let a worker compute a shard."""
        shard = item
        key = f"hapticnet-shard-{shard.first}-{shard.end}-{uuid.uuid4().hex}"
        own = versions()["hapticnet"]
        future = self._client.submit(compute_there, self._plan, tuple(shard), own, key=key, pure=False)
        self._futures[shard] = future
        future.add_done_callback(lambda done: self._done.put((shard, done)))

    def outcomes(self, timeout_s: float) -> list[Outcome]:
        """Wait until something is finished, at most this long, and return it."""
        found: list[Outcome] = []
        with suppress(queue.Empty):
            found += self._outcome(*self._done.get(timeout=timeout_s))
            while True:
                found += self._outcome(*self._done.get_nowait())
        if self._client.status != "running":
            raise UnavailableError(f"the Dask scheduler at {self._address} is gone")
        self._count()
        return found

    def drop_waiting(self) -> None:
        """Take back the shards that no worker computes yet, probably the newest."""
        for shard in list(self._futures)[self.workers :]:
            self._futures.pop(shard).cancel()

    def close(self) -> None:
        """Take back all shards, and disconnect."""
        for future in (*self._futures.values(), self._plan):
            with suppress(Exception):
                future.cancel()
        self._futures.clear()
        with suppress(Exception):
            self._client.close(timeout=CLOSE_S)

    def _outcome(self, shard: Shard, future: Any) -> list[Outcome]:
        if shard not in self._futures or self._futures[shard] is not future:  # it was taken back
            return []
        del self._futures[shard]
        try:
            computed = future.result(timeout=CONNECT_S)
        except self._killed:
            reason = "each worker that computed it ended, perhaps for lack of memory"
            return [Outcome(shard, None, EndedError(reason, final=True))]
        except Exception as error:
            if self._client.status != "running":
                raise UnavailableError(f"the Dask scheduler at {self._address} is gone") from error
            return [Outcome(shard, None, error)]  # also if its worker ended before the shard was fetched
        return [Outcome(shard, computed, None)]

    def _count(self) -> None:
        now_s = time.monotonic()
        if now_s - self._counted_s < COUNT_S:
            return
        self._counted_s = now_s
        with suppress(Exception):  # the old number is good enough
            threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=COUNT_S)
            self.workers = sum(threads.values())


AnyPool: TypeAlias = Pool | ClusterPool


def compute_there(plan: Plan, shard: tuple[int, int], hapticnet: str) -> Computed:
    """Return a shard in a worker of a cluster; raise SettingsError unless its hapticnet matches the sweep's."""
    if versions()["hapticnet"] != hapticnet:
        raise SettingsError(
            f"a worker has hapticnet {versions()['hapticnet']} and this machine {hapticnet}; install the same on all"
        )
    return compute_here(plan, shard)
