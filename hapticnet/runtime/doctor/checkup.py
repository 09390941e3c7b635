"""All of the doctor's probes, one after the other, each bounded in time. What fails becomes a finding."""

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

from hapticnet.errors import HapticnetError
from hapticnet.runtime.doctor.engine import examine_engine
from hapticnet.runtime.doctor.finding import Finding, Topic, Verdict
from hapticnet.runtime.doctor.keys import KeyFiles, examine_keys
from hapticnet.runtime.doctor.limits import examine_limits
from hapticnet.runtime.doctor.machine import Machine
from hapticnet.runtime.doctor.processor import examine_processor
from hapticnet.runtime.doctor.serial_ports import examine_serial
from hapticnet.runtime.doctor.simulator import examine_simulator
from hapticnet.runtime.doctor.sockets import examine_sockets
from hapticnet.runtime.doctor.software import examine_software
from hapticnet.runtime.doctor.timing import examine_timing
from hapticnet.runtime.serial_port import SerialSpec

SOON_S: Final = 5.0
LATER_S: Final = 30.0
"""Time a probe has [s]: one that reads files, and one that starts programs."""


class Probe(NamedTuple):
    """Part of a check-up: its subject, what examines it, and how long that may take [s]."""

    subject: str
    examine: Callable[[], list[Finding]]
    within_s: float = SOON_S


def probes(
    machine: Machine, *, keys: KeyFiles | None = None, serial: SerialSpec | None = None, simavr: bool = False
) -> list[Probe]:
    """Return the probes in the order of the report.

    Parameters
    ----------
    keys
        Where keys are; None: nowhere.
    serial
        The serial device that will be used; None: it is not known.
    simavr
        Whether the simulated device will be used.
    """
    return [
        Probe("timing", lambda: examine_timing(machine)),
        Probe("processor", lambda: examine_processor(machine)),
        Probe("limits", lambda: examine_limits(machine)),
        Probe("software", lambda: examine_software(machine), LATER_S),
        Probe("network", lambda: examine_sockets(machine)),
        Probe("serial", lambda: examine_serial(machine, serial)),
        Probe("keys", lambda: examine_keys(keys or KeyFiles())),
        Probe("simulator", lambda: examine_simulator(machine, wanted=simavr)),
        Probe("docker", lambda: examine_engine(machine), LATER_S),
    ]


def examine(probes: Sequence[Probe], on_start: Callable[[str], None] = lambda _: None) -> Iterator[Finding]:
    """Run the probes and yield their findings; tell each subject to `on_start` before it is examined."""
    for probe in probes:
        on_start(probe.subject)
        yield from _bounded(probe)


def _bounded(probe: Probe) -> list[Finding]:
    """Run a probe in a thread, which is left behind if it takes too long: a read of a driver cannot be cancelled."""
    findings: list[Finding] = []
    failures: list[str] = []

    def look() -> None:
        try:
            findings.extend(probe.examine())
        except HapticnetError as error:
            failures.append(str(error))
        except Exception as error:
            failures.append(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)

    thread = threading.Thread(target=look, name=f"doctor-{probe.subject}", daemon=True)
    thread.start()
    thread.join(probe.within_s)
    if thread.is_alive():
        return [_unknown(probe.subject, f"no answer within {probe.within_s:g} s")]
    return [*findings, *(_unknown(probe.subject, failure) for failure in failures)]


def _unknown(subject: str, failure: str) -> Finding:
    return Topic(subject, "probe", "Check-up", {"error": failure}).find(
        Verdict.WARNING,
        f"could not be completed: {failure}",
        "The rest of this subject is unknown.",
    )
