/* What the firmware allows, whatever the host asks for. Every limit with unit and source. */
#ifndef LIMITS_H
#define LIMITS_H

#include <stdint.h>

#define SERVOS 3

/* Pulses are in ticks of 0.5 us: Timer1 at 16 MHz / 8. */
#define TICKS_PER_US 2u
#define TICKS(us) ((uint16_t)((us) * TICKS_PER_US))

/* The platform's way is 1200 to 2000 us (kinematics.py: 30 degrees below level to 50 above, at the typical 10 us per
 * degree of an HS-55). 20 us more at either end let the host move one servo ahead of the others. */
#define SHORTEST_PULSE {TICKS(1180), TICKS(1180), TICKS(1180)}
#define LONGEST_PULSE {TICKS(2020), TICKS(2020), TICKS(2020)}

/* Platform at displacement 0, off the finger. */
#define RETRACTED_PULSE {TICKS(1200), TICKS(1200), TICKS(1200)}

/* Largest change toward a setpoint per frame: 60 us, 6 degrees. In 20 ms a free HS-55 turns 7 (0.17 s per 60 degrees
 * at 4.8 V, data sheet), so this holds back a leap of the setpoint, not a motion the servo could follow. */
#define LARGEST_STEP TICKS(60)

/* Period of the servo frames [ms]: 50 Hz, the convention of analog servos. */
#define FRAME_MS 20u

/* Silence [ms] after which the servos retract. The host may be silent 200 ms; the pulse that says so may start one
 * frame later, and the last of the three ends 6 ms after that. Together they stay within 220 ms even when the clock
 * is 1 % slow; the resonator of a Nano is good to 0.5 %, typical. */
#define HOST_SILENCE_MS 190u

/* The hardware watchdog is fed only while servo frames come at least this often [ms]: two frames. */
#define FRAMES_LOST_MS (2u * FRAME_MS)

#endif
