"""The same rows whatever the shards, the workers and the accidents: nothing is lost, and nothing comes twice."""

import multiprocessing
import os
from collections import deque

import pytest

from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.experiment.workers import EndedError, Outcome
from hapticnet.sweep.engine import ATTEMPTS, HOPELESS, Progress, Sizes, sweep
from hapticnet.sweep.plan import Runner, plan_of, rows_of
from hapticnet.sweep.pools import local_pool
from hapticnet.sweep.runs import Shard
from hapticnet.sweep.store import Store, compute, shard_name
from hapticnet.sweep.study import read_study


class HerePool:
    """Computes in this process, except shards that contain one of some runs, which break their worker."""

    workers = 2

    def __init__(self, plan, poison=(), most_breaks=10**6):
        self._plan, self._runner = plan, Runner(plan)
        self._poison, self._breaks = set(poison), most_breaks
        self._waiting = deque()
        self.began = []

    @property
    def in_hand(self):
        return len(self._waiting)

    @property
    def room(self):
        return 4 - self.in_hand

    def submit(self, shard):
        self._waiting.append(shard)

    def outcomes(self, timeout_s):  # noqa: ARG002
        shard = self._waiting.popleft()
        self.began.append(shard)
        if self._breaks and self._poison & set(range(*shard)):
            self._breaks -= 1
            return [Outcome(shard, None, EndedError("it ended"))]
        return [Outcome(shard, compute(self._plan, self._runner, shard), None)]

    def drop_waiting(self):
        self._waiting.clear()

    def close(self):
        pass


def swept(plan, path, pool, *, shard=None, **options) -> Progress:
    folder = Store(path)
    with folder.held():
        there = folder.open(plan, "", {})
        return sweep(plan, folder, there, pool, sizes=Sizes(shard), **options)


@pytest.fixture
def truth(plan):
    return rows_of(plan, Runner(plan), Shard(0, plan.runs))


def test_the_rows_do_not_depend_on_the_size_of_shards(plan, truth, rows, tmp_path):
    assert len(truth) == 64
    assert len({row["felt_rmse_n"] for row in truth}) > 30, "the network makes a difference"
    for size in (1, 7, 64, None):
        done = swept(plan, tmp_path / str(size), HerePool(plan), shard=size)
        assert rows(tmp_path / str(size)) == truth
        assert (done.done, done.computed, done.failed) == (64, 64, 0)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_rows_do_not_depend_on_processes_not_even_if_one_is_killed(plan, truth, rows, tmp_path, workers):
    killed = []

    def kill_one(progress):
        if not killed and 0 < progress.done < 40:
            victim = multiprocessing.active_children()[0]
            victim.kill()
            killed.append(victim.pid)

    pool = local_pool(plan, workers)
    try:
        done = swept(plan, tmp_path / "out", pool, shard=4, on_progress=kill_one)
    finally:
        pool.close()
    assert killed
    assert rows(tmp_path / "out") == truth
    assert (done.done, done.poison) == (64, [])
    assert not multiprocessing.active_children()


def test_a_sweep_that_was_stopped_goes_on_with_what_is_missing(plan, truth, rows, tmp_path):
    out = tmp_path / "out"
    pool = HerePool(plan)
    first = swept(plan, out, pool, shard=5, is_stopped=lambda: len(pool.began) > 3)
    assert first.stopped
    assert 0 < first.done < 64
    (out / f".{shard_name(Shard(40, 45), b'')}.77.part").write_bytes(b"half of a sha")  # as kill -9 leaves it
    second = swept(plan, out, HerePool(plan), shard=3)
    assert second.computed == 64 - first.done
    assert rows(out) == truth
    third = swept(plan, out, HerePool(plan))
    assert (third.computed, third.done) == (0, 64)
    assert not list(out.glob(".*.part"))


def test_more_repeats_keep_what_is_there(write_study, plan, truth, rows, tmp_path):
    file = read_study(write_study())
    swept(plan_of(file, repeats=1), tmp_path / "out", HerePool(plan), shard=6)
    assert rows(tmp_path / "out") == truth[:16]
    more = swept(plan, tmp_path / "out", HerePool(plan), shard=6)
    assert more.computed == 48
    assert rows(tmp_path / "out") == truth
    with pytest.raises(SettingsError, match="has run 63 already, and this study has 16 runs"):
        swept(plan_of(file, repeats=1), tmp_path / "out", HerePool(plan))


def test_a_shard_whose_worker_ends_each_time_is_marked_and_the_others_are_computed(plan, truth, rows, tmp_path):
    out = tmp_path / "out"
    pool = HerePool(plan, poison=[21])
    done = swept(plan, out, pool, shard=4)
    assert done.poison == [Shard(20, 24)]
    assert pool.began.count(Shard(20, 24)) == ATTEMPTS
    assert rows(out) == truth[:20] + truth[24:]
    assert done.first_reason == "it ended"
    again = swept(plan, out, HerePool(plan, poison=[21], most_breaks=2), shard=4)
    assert (again.computed, again.lost_workers, again.poison) == (4, 2, []), "the third attempt succeeds"
    assert rows(out) == truth


def test_a_sweep_ends_if_no_shard_can_be_computed(plan, tmp_path):
    pool = HerePool(plan, poison=range(64))
    with pytest.raises(UnavailableError, match="no shard can be computed: it ended; 0 of 64 runs are kept"):
        swept(plan, tmp_path / "out", pool, shard=1)
    assert len(pool.began) <= ATTEMPTS * (HOPELESS + 4)


def test_a_full_disk_is_told_in_one_line_and_the_sweep_can_go_on(plan, truth, rows, tmp_path, monkeypatch):
    synced = []

    def fsync_with_little_room(number):
        synced.append(number)
        if len(synced) > 3:
            raise OSError(28, os.strerror(28))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fsync_with_little_room)
        with pytest.raises(FileError, match=r"cannot be written: No space left on device; 12 of 64 runs are kept; run"):
            swept(plan, tmp_path / "out", HerePool(plan), shard=4)
    assert not list((tmp_path / "out").glob(".*.part"))
    assert swept(plan, tmp_path / "out", HerePool(plan)).computed == 52
    assert rows(tmp_path / "out") == truth


def test_nothing_in_the_folder_is_written_through_a_link(plan, tmp_path):
    out, precious = tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text("precious")
    (out / "study.toml").symlink_to(precious)
    swept(plan, out, HerePool(plan), shard=40)
    (out / "sweep.lock").unlink()
    (out / "sweep.lock").symlink_to(precious)
    with pytest.raises(FileError, match=r"sweep.lock is a link; expected a regular file"):
        swept(plan, out, HerePool(plan))
    assert precious.read_text() == "precious"


@pytest.mark.parametrize("name", ["shard-0000000000-0000000001-0123456789abcdef.parquet", "sweep.lock"])
def test_a_pipe_in_the_folder_is_refused_in_one_line(plan, tmp_path, name):
    swept(plan, tmp_path, HerePool(plan), shard=40)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileError, match="is a pipe; expected a regular file"):
        swept(plan, tmp_path, HerePool(plan))


@pytest.fixture
def own_codec(write_study, tmp_path):
    """Return what plans the small study with a codec of the user's that runs a statement at its start."""

    def planned(statement, *replaced):
        (tmp_path / "mine.py").write_text(
            "import os\n"
            "from hapticnet.codec.schemes.deadband import Deadband\n"
            "class Mine(Deadband):\n"
            "    name = 'mine'\n"
            "    def encoder(self, axes):\n"
            f"        if self.law.multiplier > 2: {statement}\n"
            "        return super().encoder(axes)\n"
        )
        path = write_study()
        text = path.read_text()
        for old, new in replaced:
            text = text.replace(old, new)
        path.write_text(text)
        return plan_of(read_study(path))

    return planned


def test_a_run_that_fails_has_its_error_in_the_place_of_figures(own_codec, rows, tmp_path):
    plan = own_codec(
        "raise RuntimeError('too coarse for me')", ('"deadband", "linear-predictive"', '"raw", "mine.py:Mine"')
    )
    done = swept(plan, tmp_path / "out", HerePool(plan), shard=50)
    found = rows(tmp_path / "out")
    bad = [row for row in found if row["error"] is not None]
    assert done.failed == len(bad) == 16
    assert {(row["codec"], row["multiplier"], row["felt_rmse_n"]) for row in bad} == {("mine", 2.5, None)}
    assert "too coarse for me" in done.first_error
    assert all(row["sent"] > 0 for row in found if row["error"] is None)


def test_shards_grow_to_seconds_and_shrink_toward_the_end():
    sizes = Sizes()
    assert sizes.next(10_000, 2) == 2
    sizes.note(2, 0.02)
    assert 2 < sizes.next(10_000, 2) <= 16, "not at once: the first ones include the start of a worker"
    for _ in range(5):
        sizes.note(100, 1.0)
        largest = sizes.next(10_000, 2)
    assert 250 <= largest <= 350
    assert sizes.next(400, 2) <= 100
    assert sizes.next(1, 2) >= 1


def test_a_run_that_ends_its_process_costs_its_own_shard_only(own_codec, rows, tmp_path):
    codec, once = ('["deadband", "linear-predictive"]', '"mine.py:Mine"'), ("repeats = 4", "repeats = 1")
    plan = own_codec("os._exit(1)", codec, once)  # 8 runs, the last 4 of which end their process
    pool = local_pool(plan, 2)
    try:
        done = swept(plan, tmp_path / "out", pool, shard=4)
    finally:
        pool.close()
    assert (done.done, done.lost_workers, done.poison) == (4, ATTEMPTS, [Shard(4, 8)])
    assert [row["run"] for row in rows(tmp_path / "out")] == [0, 1, 2, 3]
