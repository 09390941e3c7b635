/* Limits that the firmware enforces, with unit and source. */
#ifndef LIMITS_H
#define LIMITS_H

#include <stdint.h>

#define SERVOS 3

/* Pulses are in ticks of 0.5 us: Timer1 at 16 MHz / 8. */
#define TICKS_PER_US 2u
#define TICKS(us) ((uint16_t)((us) * TICKS_PER_US))

/* The travel is 1200 to 2000 us (kinematics.py: 30 degrees below level to 50 above, at the typical 10 us per degree of
 * an HS-55). The margin of 20 us at either end lets the host move one servo ahead of the others. */
#define SHORTEST_PULSE {TICKS(1180), TICKS(1180), TICKS(1180)}
#define LONGEST_PULSE {TICKS(2020), TICKS(2020), TICKS(2020)}

/* Platform at displacement 0, away from the finger. */
#define RETRACTED_PULSE {TICKS(1200), TICKS(1200), TICKS(1200)}

/* Largest change toward the finger per frame: 60 us, 6 degrees. In 20 ms a free HS-55 turns 7 (0.17 s per 60 degrees
 * at 4.8 V, data sheet). It lags behind its pulse, so jumps of the setpoint are followed more slowly than that. Away from
 * the finger there is no limit: a force that is gone shall be let go of as fast as the servos can. */
#define LARGEST_STEP TICKS(60)

/* Period of the servo frames [ms]: 50 Hz, the convention of analog servos. */
#define FRAME_MS 20u

/* Silence [ms] after which the servos retract. The next frame may start 20 ms later, and its last pulse ends 6 ms after
 * that: within 220 ms in total even if the clock is 1 % slow. A Nano's resonator is typically accurate to 0.5 %. */
#define HOST_SILENCE_MS 190u

/* Longest time [ms] without servo frames while the hardware watchdog is reset: two frames. */
#define FRAMES_LOST_MS (2u * FRAME_MS)

#endif
