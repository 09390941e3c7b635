"""What a worker does with a shard."""

import time

from hapticnet.sweep.grid import Shard
from hapticnet.sweep.pool import Computed
from hapticnet.sweep.runs import Plan, Runner, all_columns, rows_of
from hapticnet.sweep.table import origin, shard_bytes


def compute(plan: Plan, runner: Runner, shard: Shard) -> Computed:
    """Return a shard that is ready to be written."""
    began_s, cpu_s = time.perf_counter(), time.thread_time()
    rows = rows_of(plan, runner, shard)
    content = shard_bytes(all_columns(plan), rows, origin(plan.digest, shard))
    errors = [str(row["error"]) for row in rows if row["error"] is not None]
    return Computed(
        shard,
        content,
        failed=len(errors),
        first_error=errors[0] if errors else None,
        seconds=time.perf_counter() - began_s,
        cpu_s=time.thread_time() - cpu_s,
    )
