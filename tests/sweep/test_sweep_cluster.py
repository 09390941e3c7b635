"""Workers of a Dask scheduler, here in this process; docker-check has them on hosts of their own."""

import re
import socket

import pytest

from hapticnet.errors import UnavailableError
from hapticnet.sweep import pools as module
from hapticnet.sweep.engine import Sizes, sweep
from hapticnet.sweep.plan import Runner, rows_of
from hapticnet.sweep.pools import ClusterPool
from hapticnet.sweep.runs import Shard
from hapticnet.sweep.store import Store

distributed = pytest.importorskip("distributed")


@pytest.fixture
def cluster():
    made = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=2,
        processes=False,
        dashboard_address=None,
        protocol="tcp",
        host="127.0.0.1",
        silence_logs=60,
    )
    yield made
    made.close(timeout=5)


def swept(plan, path, pool, **options):
    folder = Store(path)
    with folder.held():
        try:
            return sweep(plan, folder, folder.open(plan, "", {}), pool, sizes=Sizes(4), **options)
        finally:
            pool.close()


def test_a_cluster_gives_the_same_rows_and_goes_on_after_its_scheduler_was_gone(
    plan, rows, tmp_path, cluster, monkeypatch
):
    monkeypatch.setattr(module, "CONNECT_S", 0.5)
    truth = rows_of(plan, Runner(plan), Shard(0, plan.runs))
    address = cluster.scheduler_address
    done = swept(plan, tmp_path / "one", ClusterPool(plan, address))
    assert (done.done, done.poison) == (64, [])
    assert rows(tmp_path / "one") == truth

    def end_scheduler(progress):
        if progress.done >= 12:
            cluster.close(timeout=5)

    expected = rf"the Dask scheduler at {re.escape(address)} is gone; \d+ of 64 runs are kept; run the same command"
    with pytest.raises(UnavailableError, match=expected):
        swept(plan, tmp_path / "two", ClusterPool(plan, address), on_progress=end_scheduler)
    kept = rows(tmp_path / "two")
    assert 12 <= len(kept) < 64
    assert kept == [truth[row["run"]] for row in kept]


def test_a_scheduler_that_does_not_answer_is_told_in_one_line(plan, monkeypatch):
    monkeypatch.setattr(module, "CONNECT_S", 0.3)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UnavailableError, match=f"^no Dask scheduler answers at {address}$"):
            ClusterPool(plan, address)
    with pytest.raises(UnavailableError, match="no Dask scheduler answers at carrier-pigeon"):
        ClusterPool(plan, "carrier-pigeon")
