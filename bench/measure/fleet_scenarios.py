"""What may happen to a service of many masters, played in the model of `fleet_model`."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Final

import simpy
from fleet_masters import TICK_S
from fleet_model import BIN_S, Model
from fleet_parts import FleetSettings

DETECT_S: Final = 3.0
"""A balancer that asks a host's /health each second and believes the third failure."""

REBOOT_S: Final = 30.0
RESTART_S: Final = 1.5
FAULT_S: Final = 10.0
"""How long a host, a process, and the network of all of them are away."""

GAP_S: Final = 5.0
"""From the moment that one host of a rolling restart is back until the next one stops."""

ROAM_S: Final = 300.0
"""How often a master's address changes."""

SESSION_S: Final = 1200.0
"""Mean length of a session; there are as many masters as arrive in this time."""

SITE: Final = 1000
"""Masters behind one address, where masters share addresses."""

UNLIMITED: Final = (1e9, 1e9)


def quantiles(values: list[float]) -> dict[str, float | None]:
    """Return what a scenario reports of the times [s] for which masters were away."""
    ordered = sorted(values)

    def at(share: float) -> float | None:
        return ordered[math.ceil(share * len(ordered)) - 1] if ordered else None

    return {"p50": at(0.5), "p90": at(0.9), "p99": at(0.99), "last": at(1.0)}


def small(result: dict[str, Any], rate_hz: float, *, kill: bool, seed: int) -> dict[str, Any]:
    """Play in the model what `fleet_masters.outage` did with real processes."""
    settings = FleetSettings(
        masters=len(result["back_s"]),
        addresses=result["addresses"],
        sample_s=TICK_S,
        position_s=1.0 / rate_hz,
        costs=result["costs"],
    )
    model = Model(settings, seed)
    model.seat_all()
    (host,) = model.hosts
    if kill:
        model.fail(host.slaves, answers_s=result["outage_s"])
    else:
        model.stop(host)
        host.in_rotation = True  # it is the only host
        model.later(result["outage_s"], lambda: model.start(host))
    model.env.run(120.0)
    assert len(model.away) == settings.masters
    return {**quantiles(model.away), "hellos": sum(model.hellos.values()), "peak_hellos_per_s": peak(model)}


def peak(model: Model) -> float:
    """Return the most HELLOs a second of all masters together."""
    return max(model.hellos.values(), default=0) / BIN_S


def outage(settings: FleetSettings, seed: int, play: Callable[[Model], None], most_s: float) -> dict[str, Any]:
    """Seat all masters, let something happen, and return how it ends."""
    model = Model(settings, seed)
    model.seat_all()
    before = max(len(slave.seated) for slave in model.slaves)
    play(model)
    model.env.run(most_s)
    return {
        "times_away": len(model.away),
        "still_away": sum(master.slave is None for master in model.masters),
        "away_s": quantiles(model.away),
        "hellos": sum(model.hellos.values()),
        "peak_hellos_per_s": peak(model),
        "outcomes": dict(model.outcomes),
        "queue_full": sum(slave.dropped for slave in model.slaves),
        "most_busy": max(slave.most_busy for slave in model.slaves),
        "most_sessions_before": before,
        "most_sessions_after": max(len(slave.seated) for slave in model.slaves),
        "most_losses": max(master.losses for master in model.masters),
    }


def host_lost(model: Model) -> None:
    """Kill a host; the balancer notices."""
    model.fail(model.hosts[0].slaves)


def host_reboots(model: Model) -> None:
    """Kill a host, which comes back; the balancer does nothing."""
    model.fail(model.hosts[0].slaves, answers_s=REBOOT_S)


def process_restarts(model: Model) -> None:
    """Kill the fullest process, which is started again."""
    model.fail([max(model.slaves, key=lambda slave: len(slave.seated))], answers_s=RESTART_S)


def all_lost(model: Model) -> None:
    """Kill every process, as a fault of the network before them seems to do."""
    model.fail(model.slaves, answers_s=FAULT_S)


def rolling(model: Model) -> None:
    """Restart every host in turn."""

    def turns() -> Iterator[simpy.Event]:
        for host in model.hosts:
            model.stop(host)
            yield model.env.timeout(RESTART_S)
            model.start(host)
            yield model.env.timeout(GAP_S)

    model.env.process(turns())


def coming_and_going(model: Model) -> None:
    """Let masters leave, and others come, at the rate that keeps their number."""

    def turns() -> Iterator[simpy.Event]:
        while True:
            yield model.env.timeout(model.rng.expovariate(len(model.masters) / SESSION_S))
            master = model.rng.choice(model.masters)
            if master.slave is not None:
                model.leave(master)
                model.join(master)

    model.env.process(turns())


def roaming(steered: bool) -> Callable[[Model], None]:
    """Return masters that change their addresses, behind a balancer that knows session numbers or only addresses."""

    def play(model: Model) -> None:
        def moves() -> Iterator[simpy.Event]:
            while True:
                yield model.env.timeout(model.rng.expovariate(len(model.masters) / ROAM_S))
                model.roam(model.rng.choice(model.masters), steered=steered)

        model.env.process(moves())

    return play


def play_all(settings: FleetSettings, seed: int) -> dict[str, Any]:
    """Return every scenario for one service."""
    patient = replace(settings.session, slowest_hello_us=settings.session.hello_interval_us)
    free = replace(settings.costs, cookie_us=0.0, drop_us=0.0, admit_us=0.0, reset_us=0.0)
    lifted = {
        "as it is": settings,
        "without the limit of a process": replace(settings, in_all=UNLIMITED),
        "without the limit of an address": replace(settings, per_address=UNLIMITED),
        "without back-off of HELLOs": replace(settings, session=patient),
        "without CPU time for HELLOs": replace(settings, costs=free),
    }
    sites = replace(settings, addresses=max(1, settings.masters // SITE))
    rolled_s = settings.hosts * (RESTART_S + GAP_S)
    return {
        "coming and going": outage(settings, seed, coming_and_going, 60.0),
        "process restarts": outage(settings, seed, process_restarts, 60.0),
        "host lost": outage(settings, seed, host_lost, 60.0),
        "host reboots": outage(settings, seed, host_reboots, 150.0),
        "all lost": outage(settings, seed, all_lost, 100.0),
        "rolling restart": outage(settings, seed, rolling, rolled_s + 30.0) | {"takes_s": rolled_s},
        "roaming, steered by address": outage(settings, seed, roaming(steered=False), 60.0),
        "roaming, steered by session": outage(settings, seed, roaming(steered=True), 60.0),
        "host lost, sites": outage(sites, seed, host_lost, 300.0),
        "process restarts, sites by address": outage(replace(sites, by_address=True), seed, process_restarts, 1800.0),
        "lifted": {name: outage(each, seed, host_reboots, 150.0)["away_s"] for name, each in lifted.items()},
    }
