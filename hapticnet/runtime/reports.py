"""The reports of masters and slaves that run in real time: the same fields from the command line and from Python."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from hapticnet.channel.emulator import Emulator
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode
from hapticnet.runtime.master_run import MasterRun
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.recorder import Recorder


def master_report(
    node: MasterNode,
    run: MasterRun | None,
    overload: Overload,
    *,
    faults: Sequence[str] = (),
    operator: Mapping[str, Any] | None = None,
    recorder: Recorder | None = None,
    channel_out: Emulator[Any] | None = None,
    channel_in: Emulator[Any] | None = None,
) -> dict[str, Any]:
    """Return the account of a master for JSON; None for what it does not have.

    `run` is None if it does not end; `faults` is what else was wrong with code that was stepped, and `operator`
    the operator's own account.
    """
    return {
        "scheduling": overload.scheduling,
        **node.report(),
        **(dict.fromkeys(MasterRun.__dataclass_fields__) if run is None else asdict(run)),
        "overload": overload.report(),
        "faults": [*map(str, node.times.reported), *faults],
        "operator": operator,
        "recording": None if recorder is None else recorder.report(),
        "channel_out": None if channel_out is None else _channel_account(channel_out),
        "channel_in": None if channel_in is None else _channel_account(channel_in),
    }


def slave_report(
    node: SlaveNode,
    overload: Overload,
    *,
    faults: Sequence[str] = (),
    recorder: Recorder | None = None,
    channel_out: Emulator[Any] | None = None,
) -> dict[str, Any]:
    """Return the account of a slave for JSON; None for what it does not have."""
    return {
        "scheduling": overload.scheduling,
        **node.report(),
        "overload": overload.report(),
        "faults": [*map(str, node.times.reported), *faults],
        "recording": None if recorder is None else recorder.report(),
        "channel_out": None if channel_out is None else _channel_account(channel_out),
    }


def _channel_account(channel: Emulator[Any]) -> dict[str, Any]:
    """Return what an emulated channel did, with its settings at the end."""
    return {"settings": channel.settings.describe(), **asdict(channel.counters)}
