/* What the servos are allowed to do: the last word, whatever the host says or fails to say. */
#ifndef SAFETY_H
#define SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

struct safety {
    bool greeted;                /* a HELLO of this protocol was heard */
    bool commanded;              /* a setpoint is in force; otherwise retracted */
    bool step_limited;           /* at the last frame */
    uint32_t heard_ms;           /* when the newest setpoint was taken */
    uint32_t frame_ms;           /* when the last frame was */
    struct setpoint wanted;      /* the newest setpoint */
    uint16_t applied_sequence;   /* of the setpoint in force at the last frame */
    uint16_t held[SERVOS];       /* pulses of the last frame, ticks of 0.5 us */
};

/* As after a reset: retracted, no host. */
void safety_start(struct safety *s, uint32_t now_ms);

/* A host introduced itself. A host of another protocol major is not listened to. */
void safety_greet(struct safety *s, uint8_t protocol_major);

/* Take a setpoint as the newest; false when it is refused: no HELLO yet, or a pulse outside its servo's limits. */
bool safety_command(struct safety *s, const struct setpoint *setpoint, uint32_t now_ms);

/* Settle the pulses s->held of the servo frame that starts now. */
void safety_frame(struct safety *s, uint32_t now_ms);

/* Whether the hardware watchdog may be fed: only while servo frames keep coming. */
bool safety_alive(const struct safety *s, uint32_t now_ms);

#endif
