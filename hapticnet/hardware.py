"""Nominal values of the fingertip device and of the finger on it, for controllers, descriptions and simulations."""

from typing import Final

MAX_FORCE_N: Final = 5.0  # largest force [N] the paper's fingertip device renders
SLEW_N_PER_S: Final = 50.0
"""Largest rate of rise [N/s] of the force requested of it, and of the held force after the link recovers. An
assumption: 0 to 5 N in 100 ms is two thirds of what the HS-55 can do with a 12 mm arm against a 1 N/mm finger
(74 mm/s), so correct stimuli are not delayed and a wrong one does not strike."""

SENSOR_THRESHOLD_N: Final = 0.2  # smallest force [N] that a sensor of the FSR 400 series detects (data sheet)
SERVO_FRAME_US: Final = 20_000  # period [µs] at which a servo takes a new pulse: 50 Hz, as usual for analog servos
SERVO_DEADBAND_US: Final = 8.0  # change of pulse [µs] below which a servo does not move; typical of the HS-55
SERVO_LAG_S: Final = 0.03  # time constant [s] of a servo's first-order lag; 20 to 40 ms is typical of the HS-55
CONTACT_M: Final = 0.002  # Platform displacement [m] at which it touches the finger. An assumption.
STIFFNESS_N_M: Final = 1000.0  # tangent stiffness [N/m] of a finger at 1 N; 300 to 3000 is typical

SOFTEST_N_M: Final = 200.0
STIFFEST_N_M: Final = 5000.0
"""Limits [N/m] of the stiffness at 1 N that a fingertip can have."""

STIFFENING: Final = 0.3
"""Share of a finger's stiffness at 1 N that comes from the force (dimensionless). An assumption: fingers vary.

The force is ``k0 / b · (exp(b · compression) − 1)``, the form that Pawluk and Howe (1999, "Dynamic contact of the human
fingerpad against a flat surface") found for 0 to 2 N, without their relaxation. The tangent stiffness is
``k0 + b · force``; at 1 N, `STIFFENING` is the share of b.
"""
