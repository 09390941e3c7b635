/* Limits of range, step and silence. Only differences of unsigned milliseconds are used, so wrapping is harmless. */
#include "safety.h"

static const uint16_t shortest[SERVOS] = SHORTEST_PULSE;
static const uint16_t longest[SERVOS] = LONGEST_PULSE;
static const uint16_t retracted[SERVOS] = RETRACTED_PULSE;

void safety_start(struct safety *s, uint32_t now_ms)
{
    *s = (struct safety){.frame_ms = now_ms};
    for (uint8_t i = 0; i < SERVOS; i++)
        s->held[i] = retracted[i];
}

void safety_greet(struct safety *s, uint8_t protocol_major)
{
    s->greeted = protocol_major == PROTOCOL_MAJOR;
    s->commanded = false;
}

bool safety_command(struct safety *s, const struct setpoint *setpoint, uint32_t now_ms)
{
    if (!s->greeted)
        return false;
    for (uint8_t i = 0; i < SERVOS; i++)
        if (setpoint->pulses[i] < shortest[i] || setpoint->pulses[i] > longest[i])
            return false;
    s->wanted = *setpoint;
    s->heard_ms = now_ms;
    s->commanded = true;
    return true;
}

static uint16_t stepped(uint16_t held, uint16_t wanted, bool *limited)
{
    if (wanted > held + LARGEST_STEP) {
        *limited = true;
        return (uint16_t)(held + LARGEST_STEP);
    }
    return wanted; /* moving away from the finger is never limited */
}

void safety_frame(struct safety *s, uint32_t now_ms)
{
    s->frame_ms = now_ms;
    s->step_limited = false;
    if (now_ms - s->heard_ms >= HOST_SILENCE_MS)
        s->commanded = false;
    if (s->commanded)
        s->applied_sequence = s->wanted.sequence;
    for (uint8_t i = 0; i < SERVOS; i++) /* retracting has no step limit */
        s->held[i] = s->commanded ? stepped(s->held[i], s->wanted.pulses[i], &s->step_limited) : retracted[i];
}

bool safety_alive(const struct safety *s, uint32_t now_ms)
{
    return now_ms - s->frame_ms <= FRAMES_LOST_MS;
}
