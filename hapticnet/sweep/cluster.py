"""Workers of a Dask cluster, on any machine that a scheduler knows."""

import logging
import queue
import time
import uuid
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any, Final

from hapticnet.errors import UnavailableError, in_words
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.pool import Broken, Computed, Outcome
from hapticnet.sweep.runs import Plan
from hapticnet.sweep.table import versions

NEEDS: Final = "--scheduler needs Dask's distributed (extra cluster): pip install distributed"

CONNECT_S: Final = 10.0
"""Time [s] in which a scheduler must answer, at the beginning and after the connection was lost."""

IN_HAND: Final = 2
"""Shards for each thread of the workers: the one it computes, and the next."""

COUNT_S: Final = 2.0
"""Time [s] between two counts of the workers."""

FETCH_S: Final = 30.0
CLOSE_S: Final = 3.0


class ClusterPool:
    """Workers of a Dask scheduler; see `pool.Pool`.

    Workers send the bytes of their shards, so no folder is shared. If a worker ends, others compute its shards.

    Parameters
    ----------
    address
        The scheduler, as tcp://HOST:PORT.

    Raises
    ------
    UnavailableError
        If distributed is not installed, no scheduler answers, or it cannot take the study.
    """

    def __init__(self, plan: Plan, address: str) -> None:
        try:
            from distributed import Client, KilledWorker

            from hapticnet.sweep.cluster_worker import Keeper, compute_here
        except ImportError as error:
            raise UnavailableError(NEEDS) from error
        for name in ("distributed", "tornado"):  # their lines tell of what is handled here
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        self._address = address
        self._digest = plan.digest
        self._compute, self._killed = compute_here, KilledWorker
        self._keeper = Keeper(plan)
        self._name = f"hapticnet-{plan.digest[:12]}-{uuid.uuid4().hex[:8]}"
        self._futures: dict[Shard, Any] = {}
        self._lost: list[Shard] = []
        self._done: queue.SimpleQueue[tuple[Shard, Any]] = queue.SimpleQueue()
        try:
            make_client: Any = Client
            self._client = make_client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:
            raise UnavailableError(f"no Dask scheduler answers at {address}") from error
        self._workers = 0
        self._counted_s = -COUNT_S
        self._silent_since_s: float | None = None
        self._register()
        self._count()

    @property
    def workers(self) -> int:
        """Number of threads of all workers."""
        return self._workers

    @property
    def in_hand(self) -> int:
        """Number of shards it was given and has not returned."""
        return len(self._futures) + len(self._lost)

    @property
    def room(self) -> int:
        """How many more shards it should be given now. Without workers they wait at the scheduler."""
        return IN_HAND * max(self._workers, 1) - self.in_hand

    def submit(self, shard: Shard) -> None:
        """Let a worker compute a shard."""
        future = self._client.submit(
            self._compute,
            self._digest,
            *shard,
            versions()["hapticnet"],
            key=f"hapticnet-shard-{shard.first}-{shard.end}-{uuid.uuid4().hex}",
            pure=False,
        )
        self._futures[shard] = future
        future.add_done_callback(lambda done: self._done.put((shard, done)))

    def outcomes(self, timeout_s: float) -> list[Outcome]:
        """Wait until something is finished, at most so long, and return it."""
        found: list[Outcome] = []
        with suppress(queue.Empty):
            found += self._outcome(*self._done.get(timeout=timeout_s))
            while True:
                found += self._outcome(*self._done.get_nowait())
        self._check_connection()
        self._count()
        return found

    def drop_waiting(self) -> None:
        """Take back the shards that nobody computes yet: probably the newest."""
        waiting = list(self._futures)[max(self._workers, 0) :]
        for shard in waiting:
            self._futures.pop(shard).cancel()
        self._lost.clear()

    def close(self) -> None:
        """Give back what the cluster keeps of the study, and leave."""
        for future in self._futures.values():
            with suppress(Exception):
                future.cancel()
        self._futures.clear()
        with suppress(Exception):
            if self._client.status == "running":
                self._client.sync(
                    self._client.scheduler.unregister_worker_plugin, name=self._name, callback_timeout=CLOSE_S
                )
        with suppress(Exception):
            self._client.close(timeout=CLOSE_S)

    def _outcome(self, shard: Shard, future: Any) -> list[Outcome]:
        if shard not in self._futures or self._futures[shard] is not future:  # it was taken back, or given again
            return []
        if future.status == "finished":
            try:
                computed: Computed = future.result(timeout=FETCH_S)
            except TimeoutError:  # its worker ended before it was fetched; it is computed again
                future.add_done_callback(lambda done: self._done.put((shard, done)))
                return []
            except CancelledError:  # the connection was lost
                return self._give_again(shard)
            except Exception as error:
                if self._client.status != "running":
                    return self._give_again(shard)
                del self._futures[shard]
                return [Broken(shard, in_words(error))]
            del self._futures[shard]
            return [computed]
        if future.status == "error":
            del self._futures[shard]
            raised = future.exception()
            if isinstance(raised, self._killed):
                return [Broken(shard, "each worker that computed it ended, perhaps for lack of memory", final=True)]
            return [Broken(shard, in_words(raised))]
        return self._give_again(shard)  # the connection was lost, and with it all futures

    def _give_again(self, shard: Shard) -> list[Outcome]:
        del self._futures[shard]
        self._lost.append(shard)
        return []

    def _check_connection(self) -> None:
        """After a connection that was lost, give the scheduler everything again, or give up."""
        if self._client.status != "running":
            now_s = time.monotonic()
            self._silent_since_s = self._silent_since_s or now_s
            if self._client.status == "closed" or now_s - self._silent_since_s > CONNECT_S:
                raise UnavailableError(f"the Dask scheduler at {self._address} is gone")
            return
        self._silent_since_s = None
        if self._lost:
            self._register()  # it may be another scheduler at the same address
            lost, self._lost = self._lost, []
            for shard in lost:
                self.submit(shard)

    def _register(self) -> None:
        try:
            self._client.register_plugin(self._keeper, name=self._name)
        except Exception as error:
            raise UnavailableError(
                f"the Dask cluster at {self._address} cannot take the study; install the same hapticnet,"
                f" with the extras cluster and sweep, at its scheduler and workers: {in_words(error)}"
            ) from error

    def _count(self) -> None:
        now_s = time.monotonic()
        if now_s - self._counted_s < COUNT_S or self._client.status != "running":
            return
        self._counted_s = now_s
        with suppress(Exception):  # the old number is good enough
            threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=COUNT_S)
            self._workers = sum(threads.values())
