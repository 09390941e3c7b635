"""The simulated device: compiler, headers, and whether the built simulator runs."""

from collections.abc import Sequence
from contextlib import closing
from typing import Final

from hapticnet.errors import HapticnetError, UnavailableError
from hapticnet.runtime.doctor.finding import Finding, Step, Topic, Verdict
from hapticnet.runtime.doctor.machine import Machine
from hapticnet.runtime.simavr import BUILD_VARIABLE, Simavr, simavr_build

SUBJECT: Final = "simulator"

TOOLS: Final = {
    "avr-gcc": ("gcc-avr", None),
    "simavr": ("libsimavr-dev", "/usr/include/simavr/sim_avr.h"),
    "libelf": ("libelf-dev", "/usr/include/libelf.h"),
}
"""What the simulator is built with: Debian's package, and a file of it; None: a program on the search path."""

BUILD: Final = Step(
    f"In a checkout, install the tools and build it (then {BUILD_VARIABLE} names its firmware/build):", "make simulator"
)

TRIAL_US: Final = 1000


def examine_simulator(machine: Machine, *, wanted: bool = False) -> list[Finding]:
    """Return the findings about the simulator; `wanted`: --device simavr will be used."""
    built, failure = _run()
    missing = [
        name
        for name, (_, file) in TOOLS.items()
        if not (machine.program(name) is not None if file is None else machine.exists(file))
    ]
    return [judge_simulator(failure, built=built, wanted=wanted), judge_tools(missing)]


def _run() -> tuple[bool, str | None]:
    """Run the firmware in the simulator for a moment; return whether it is built, and what failed."""
    try:
        files = simavr_build()
    except UnavailableError as error:
        return False, str(error)
    try:
        with closing(Simavr(*files)) as simavr:
            simavr.advance(TRIAL_US)
    except HapticnetError as error:
        return True, str(error)
    return True, None


def judge_simulator(failure: str | None, *, built: bool, wanted: bool) -> Finding:
    """Judge the simulator by what failed when it ran; None: nothing."""
    topic = Topic(SUBJECT, "simulator", "Simulated device", {"built": built, "runs": failure is None})
    if failure is None:
        return topic.ok("built; it ran the firmware for 1 ms")
    if built:
        return topic.find(Verdict.PROBLEM, failure, "--device simavr cannot work.", BUILD)
    verdict = Verdict.PROBLEM if wanted else Verdict.ABSENT
    return topic.find(verdict, "not built; needed for --device simavr only", "", BUILD)


def judge_tools(missing: Sequence[str]) -> Finding:
    """Judge the tools by those that are missing."""
    topic = Topic(SUBJECT, "tools", "Tools to build it", {name: name not in missing for name in TOOLS})
    if not missing:
        return topic.ok(", ".join(TOOLS))
    packages = [TOOLS[name][0] for name in missing] + ["avr-libc"] * ("avr-gcc" in missing)
    value = f"missing: {', '.join(missing)}; needed to build firmware and simulator only"
    return topic.absent(value, Step("Install them:", f"sudo apt-get install {' '.join(packages)}"))
