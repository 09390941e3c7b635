"""Gain and phase margins of the force loop, from a linear model.

Around a constant target the loop is linear: the learned finger is a low-pass with gain H, the platform is a servo with
frames and lag P, and a reading is the mean A over a control period. With ``rho`` the ratio of the finger's stiffness to
the model's and ``c`` the caution, the platform is sent to ``u = H·(A·P·u − rho·A·P·u) + c·rho·A·P·u``, so the open
loop is ``L = rho·(H − c)·A·P / (1 − H·A·P)``. The margins are the textbook ones (Åström and Murray, "Feedback Systems",
section 10.3), read from L on a grid of frequencies.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticnet.control.finger import LearnedFinger, compressed
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.hardware import SERVO_FRAME_US, SERVO_LAG_S

FREQUENCIES: int = 4000
HELD_S = 2.0  # time [s] for which the target is held before the margins are computed


@dataclass(frozen=True, slots=True, kw_only=True)
class Actuator:
    """Dynamics between the commanded displacement and the sensed force."""

    lag_s: float = SERVO_LAG_S  # time constant of the servos' lag [s]
    frame_s: float = SERVO_FRAME_US * 1e-6  # period of the servo frames [s]
    # Transport delay [s]: setpoint to the device, its pulses, reading back. About 5 ms for the Nano.
    transport_s: float = 0.005
    # Delay [s] of the reading that the host does not compensate, so that force and position do not match
    unseen_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins of the force loop."""

    # Factor by which the finger may be stiffer than the model before the loop is unstable; infinite if it never is
    gain: float
    # Distance [deg] of the phase from -180°, without sign, where the open loop's gain is one. Stability is decided by
    # `gain` alone: the loop is unstable if it is below one.
    phase_deg: float
    crossover_hz: float  # frequency [Hz] at which the open loop's gain is one


def loop_margins(settings: ForceControlSettings, actuator: Actuator, *, force_n: float, stiffness: float) -> Margins:
    """Return the margins while a force [N] is held on a finger `stiffness` times as stiff as the model."""
    finger = _held(settings, force_n)
    frequency_hz = np.geomspace(0.01, 0.5e6 / settings.period_us, FREQUENCIES)
    loop = stiffness * _open_loop(settings, actuator, finger, force_n, 2.0 * np.pi * frequency_hz)
    gain, phase_deg = np.abs(loop), np.degrees(np.unwrap(np.angle(loop)))
    # In a Nyquist plot -180°, -540°, … are the same point, and it may be passed from either side.
    turns = np.floor((phase_deg + 180.0) / 360.0)
    critical = np.flatnonzero(np.diff(turns))
    gain_margin = min((float(1.0 / gain[index]) for index in critical), default=float("inf"))
    crossings = np.flatnonzero(np.diff(gain > 1.0))
    if not crossings.size:
        return Margins(gain_margin, float("inf"), float("nan"))
    apart_deg = np.abs(phase_deg[crossings] % 360.0 - 180.0)
    worst = int(np.argmin(apart_deg))
    return Margins(gain_margin, float(apart_deg[worst]), float(frequency_hz[crossings[worst]]))


def _held(settings: ForceControlSettings, force_n: float) -> LearnedFinger:
    finger = LearnedFinger(settings.finger)
    period_s = settings.period_us * 1e-6
    compliance_m_n = finger.compliance_m_n
    finger.touch(compliance_m_n * compressed(force_n / 4.0), force_n / 4.0)
    for step in range(round(HELD_S / period_s)):
        at_n = force_n * min(1.0, 0.25 + 0.05 * step)
        finger.learn(compliance_m_n * compressed(at_n), at_n, 0.0, period_s)
    return finger


def _open_loop(
    settings: ForceControlSettings,
    actuator: Actuator,
    finger: LearnedFinger,
    force_n: float,
    radians_s: NDArray[np.float64],
) -> NDArray[np.complex128]:
    period_s = settings.period_us * 1e-6
    laplace = 1j * radians_s
    delayed = np.exp(-laplace * period_s)
    share = finger.gain_at(force_n, period_s)
    learned = share / (1.0 - (1.0 - share) * delayed)
    caution = 1.0 - finger.cautious_m_n / finger.compliance_m_n
    # A frame takes a setpoint that is half a control period old on average, and holds it.
    waited = np.exp(-laplace * (0.5 * period_s + actuator.transport_s)) * _mean_over(actuator.frame_s, radians_s)
    platform = waited / (1.0 + laplace * actuator.lag_s) * _mean_over(period_s, radians_s)
    unseen = np.exp(-laplace * actuator.unseen_s)
    loop: NDArray[np.complex128] = (learned - caution) * platform * unseen / (1.0 - learned * platform)
    return loop


def _mean_over(span_s: float, radians_s: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the frequency response of a mean over, or a hold for, a span of time [s]."""
    mean: NDArray[np.complex128] = np.sinc(radians_s * span_s / (2.0 * np.pi)) * np.exp(-0.5j * radians_s * span_s)
    return mean
