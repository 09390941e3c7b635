"""Wave variables: force and velocity travel as two waves, whose energy no delay can change.

After G. Niemeyer and J.-J. E. Slotine, "Stable adaptive teleoperation", IEEE Journal of Oceanic Engineering 16 (1991).
With the wave impedance b, b·v + F travels to the slave and b·v − F to the master. The wave to the slave is sent as its
integral, b·x_m + P_m with the impulse P_m = ∫F_m dt, so that a lost packet loses nothing and no drift builds up. The
slave's end is matched, with a damper b beside the scene; a filter keeps pulses from running to and fro. It follows that

    2b x_s + P_s = b x_m + P_m,     F_m = F_s + b·v_m

with P_s = ∫F_s dt of the scene's force F_s, which is also the returning wave. P_s is sent back, and replaces what the
master has summed of a force that was held over losses or silence.

Without loss no more energy comes out than has gone in, but for what the tool's first two movements into a contact
give. Over loss and jitter, a force that is held while no newer one arrives may give out as much again as it does in a
tick, for each tick of that silence. The integrals keep this from adding up: after lost positions the slave applies
the mean of the missing waves, which has less energy than they had, and what a held force has added to the master's
wave is taken out again when P_s arrives.

The published impedance is 0.3 N·s/m (S. Bernhard, chai3d, examples/GLFW/32-spring). A delay T each way shows the hand a
compliance of T/b before the scene's own.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from hapticnet.checks import check_above, check_parameter
from hapticnet.control.ports import Port
from hapticnet.samples import Vector
from hapticnet.vectors import along, magnitude, minus, plus, times
from hapticnet_literature.totals import BYTES, Totals, packed
from hapticnet_literature.touch import Touch

STEP_N_S: Final = 1e-7  # count of impulse on the wire [N·s]

LONGEST_S: Final = 0.02  # longest time [s] for which a force is summed; after a pause it goes on from there


class WaveMaster:
    """The end of the waves at the master. Satisfies `ports.MasterEnd`."""

    def __init__(self, port: Port, impedance: float) -> None:
        self.held_back = 0  # a wave is never held back
        zero = (0.0,) * port.axes
        self._impedance, self._most_n = impedance, port.max_force_n
        self._returned = Totals(port.axes, STEP_N_S)
        self._returned_n_s: Vector = zero  # ∫F_s dt [N·s]
        self._damped_n_s: Vector = zero  # ∫(F_m − F_s) dt [N·s]
        self._wave_n: Vector = zero  # F_s as it is applied [N]
        self._applied_n: Vector = zero
        self._speed_m_per_s: Vector = zero
        self._position_m: Vector | None = None
        self._now_us = 0
        self._summed = False  # whether the time up to this tick is summed

    def outgoing(self, position_m: Vector, now_us: int) -> bytes:
        """Return the impulse that the hand has received."""
        self._sum(position_m, now_us)
        return packed(plus(self._returned_n_s, self._damped_n_s), STEP_N_S)

    def incoming(self, data: bytes) -> None:
        """Note the impulse that the scene has given."""
        self._returned_n_s = self._returned.receive(data)

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:  # noqa: ARG002
        """Return the force [N] of the wave, and of the wave impedance against the motion."""
        if not self._summed:
            self._sum(position_m, now_us)
        self._summed = False
        self._wave_n = force_n
        applied_n = along(force_n, self._impedance, self._speed_m_per_s)
        size_n = magnitude(applied_n)
        self._applied_n = times(applied_n, self._most_n / size_n) if size_n > self._most_n else applied_n
        return self._applied_n

    def report(self) -> dict[str, float]:
        """Return the impulse of the scene [N·s]."""
        return {"returned_n_s": magnitude(self._returned_n_s)}

    def _sum(self, position_m: Vector, now_us: int) -> None:
        """Sum the forces of the time since the last tick."""
        before_m, elapsed_s = self._position_m, 1e-6 * (now_us - self._now_us)
        self._position_m, self._now_us, self._summed = position_m, now_us, True
        if before_m is None or not 0.0 < elapsed_s <= LONGEST_S:
            return
        self._speed_m_per_s = times(minus(position_m, before_m), 1.0 / elapsed_s)
        self._returned_n_s = along(self._returned_n_s, elapsed_s, self._wave_n)
        self._damped_n_s = along(self._damped_n_s, elapsed_s, minus(self._applied_n, self._wave_n))


class WaveSlave:
    """The matched end of the waves at the slave. Satisfies `ports.SlaveEnd`."""

    def __init__(self, port: Port, impedance: float, filter_s: float) -> None:
        self._impedance, self._filter_s = impedance, filter_s
        self._received = Totals(port.axes, STEP_N_S)
        self._begun_n_s: Vector = ()  # wave of the first position, with which the tool begins where the hand is
        self._wave_n_s: Vector = ()  # wave after the filter
        self._given_n_s: Vector = (0.0,) * port.axes  # ∫F_s dt [N·s]
        self._touch = Touch(port.axes)

    def command(self, position_m: Vector, t_us: int, data: bytes) -> Vector:
        """Return where the wave moves the tool [m] until its force and that of damper and scene are equal."""
        arrived_n_s = along(self._received.receive(data), self._impedance, position_m)
        touch, double = self._touch, 2.0 * self._impedance
        touch.step(t_us)
        if touch.position_m is None:
            self._wave_n_s, self._begun_n_s = arrived_n_s, along(arrived_n_s, -double, position_m)
            touch.tool_m = position_m
        else:
            share = 1.0 - math.exp(-touch.elapsed_s / self._filter_s) if self._filter_s else 1.0
            self._wave_n_s = along(self._wave_n_s, share, minus(arrived_n_s, self._wave_n_s))
            free_m = times(minus(minus(self._wave_n_s, self._begun_n_s), self._given_n_s), 1.0 / double)
            # The scene's force at the end of the step moves the tool; that at its begin would throw it about.
            yields = touch.elapsed_s / double
            touch.tool_m = along(free_m, -yields, touch.expected(free_m, yields))
        return touch.tool_m

    def answer(self, force_n: Vector) -> tuple[Vector, bytes]:
        """Return the scene's force, and its impulse so far."""
        self._given_n_s = along(self._given_n_s, self._touch.elapsed_s, force_n)
        self._touch.feel(force_n)
        return force_n, packed(self._given_n_s, STEP_N_S)


@dataclass(frozen=True, slots=True)
class WaveVariables:
    """Send force and motion as waves, with a matched end at the slave.

    Attributes
    ----------
    impedance
        Wave impedance b [N·s/m]: low is light in free motion, high is stiff in contact.
    filter_ms
        Time constant [ms] of the filter of the wave at the slave; 0: none, and a stiff scene gives out energy.
    """

    name: ClassVar[str] = "wave-variables"
    impedance: float = 0.3
    filter_ms: float = 10.0

    def __post_init__(self) -> None:
        check_above("wave impedance", self.impedance, 0.0, 1e4, "N·s/m")
        check_parameter("filter of the wave", self.filter_ms, 0.0, 1000.0, "ms")

    def forward_bytes(self, axes: int) -> int:
        """Return the length of the master's impulse [B]."""
        return BYTES * axes

    def feedback_bytes(self, axes: int) -> int:
        """Return the length of the slave's impulse [B]."""
        return BYTES * axes

    def master(self, port: Port) -> WaveMaster:
        """Return a new end at the master."""
        return WaveMaster(port, self.impedance)

    def slave(self, port: Port) -> WaveSlave:
        """Return a new end at the slave."""
        return WaveSlave(port, self.impedance, 1e-3 * self.filter_ms)
