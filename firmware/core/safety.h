/* Safety limits of the servos, enforced whatever the host sends or fails to send. */
#ifndef SAFETY_H
#define SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

struct safety {
    bool greeted;                /* a HELLO of this protocol was received */
    bool commanded;              /* a setpoint is in force; otherwise retracted */
    bool step_limited;           /* at the last frame */
    uint32_t heard_ms;           /* time of the newest setpoint */
    uint32_t frame_ms;           /* time of the last frame */
    struct setpoint wanted;      /* the newest setpoint */
    uint16_t applied_sequence;   /* sequence of the setpoint in force at the last frame */
    uint16_t held[SERVOS];       /* pulses of the last frame, ticks of 0.5 us */
};

/* Set the state after a reset: retracted, no host. */
void safety_start(struct safety *s, uint32_t now_ms);

/* Process a HELLO. Setpoints of a host with another major protocol version are refused. */
void safety_greet(struct safety *s, uint8_t protocol_major);

/* Accept a setpoint; return false if it is refused: no HELLO yet, or a pulse outside its servo's limits. */
bool safety_command(struct safety *s, const struct setpoint *setpoint, uint32_t now_ms);

/* Compute the pulses s->held of the servo frame that starts now. */
void safety_frame(struct safety *s, uint32_t now_ms);

/* Return whether to reset the hardware watchdog: only while servo frames continue. */
bool safety_alive(const struct safety *s, uint32_t now_ms);

#endif
