/* Encode and decode messages, independent of the compiler's padding and byte order. */
#include "messages.h"

static uint16_t get16(const uint8_t *bytes)
{
    return (uint16_t)(bytes[0] | (uint16_t)bytes[1] << 8);
}

static uint8_t *put16(uint8_t *bytes, uint16_t value)
{
    *bytes++ = (uint8_t)value;
    *bytes++ = (uint8_t)(value >> 8);
    return bytes;
}

static uint8_t *put32(uint8_t *bytes, uint32_t value)
{
    return put16(put16(bytes, (uint16_t)value), (uint16_t)(value >> 16));
}

bool get_hello(struct hello *m, const uint8_t *body, uint8_t length)
{
    if (length != 3 || body[0] != HELLO)
        return false;
    m->protocol_major = body[1];
    m->protocol_minor = body[2];
    return true;
}

bool get_setpoint(struct setpoint *m, const uint8_t *body, uint8_t length)
{
    if (length != 3 + 2 * SERVOS || body[0] != SETPOINT)
        return false;
    m->sequence = get16(body + 1);
    for (uint8_t i = 0; i < SERVOS; i++)
        m->pulses[i] = get16(body + 3 + 2 * i);
    return true;
}

bool get_stream(struct stream *m, const uint8_t *body, uint8_t length)
{
    if (length != 2 || body[0] != STREAM)
        return false;
    m->period_ms = body[1];
    return true;
}

uint8_t put_identity(const struct identity *m, uint8_t *body)
{
    uint8_t *at = body;
    *at++ = IDENTITY;
    *at++ = m->protocol_major;
    *at++ = m->protocol_minor;
    *at++ = m->firmware_major;
    *at++ = m->firmware_minor;
    *at++ = m->firmware_patch;
    *at++ = m->reset_cause;
    at = put16(at, m->boot_id);
    at = put32(at, m->clock_hz);
    for (uint8_t i = 0; i < SERVOS; i++)
        at = put16(put16(at, m->limits[i][0]), m->limits[i][1]);
    at = put16(at, m->largest_step);
    *at++ = m->adc_bits;
    return (uint8_t)(at - body);
}

uint8_t put_reading(const struct reading *m, uint8_t *body)
{
    uint8_t *at = body;
    *at++ = READING;
    at = put16(at, m->sequence);
    at = put32(at, m->uptime_ms);
    at = put16(at, m->boot_id);
    at = put16(at, m->adc);
    *at++ = m->flags;
    at = put16(at, m->applied_sequence);
    *at++ = m->damaged;
    *at++ = m->refused;
    *at++ = m->overruns;
    return (uint8_t)(at - body);
}

uint8_t put_stream_ack(const struct stream_ack *m, uint8_t *body)
{
    body[0] = STREAM_ACK;
    body[1] = m->asked_ms;
    body[2] = m->period_ms;
    return 3;
}
