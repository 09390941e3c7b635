/* Execute messages from the host and send readings. */
#include "device.h"

void device_start(struct device *d, const struct board *board, uint32_t now_ms)
{
    *d = (struct device){.board = *board};
    safety_start(&d->safety, now_ms);
}

static uint8_t introduce(const struct device *d, uint8_t *out)
{
    static const uint16_t shortest[SERVOS] = SHORTEST_PULSE;
    static const uint16_t longest[SERVOS] = LONGEST_PULSE;
    uint8_t body[LONGEST_BODY];
    struct identity m = {
        .protocol_major = PROTOCOL_MAJOR,
        .protocol_minor = PROTOCOL_MINOR,
        .firmware_major = FIRMWARE_MAJOR,
        .firmware_minor = FIRMWARE_MINOR,
        .firmware_patch = FIRMWARE_PATCH,
        .reset_cause = d->board.reset_cause,
        .boot_id = d->board.boot_id,
        .clock_hz = d->board.clock_hz,
        .largest_step = LARGEST_STEP,
        .adc_bits = d->board.adc_bits,
    };
    for (uint8_t i = 0; i < SERVOS; i++) {
        m.limits[i][0] = shortest[i];
        m.limits[i][1] = longest[i];
    }
    return frame(body, put_identity(&m, body), out);
}

static uint8_t set_stream(struct device *d, uint8_t asked_ms, uint8_t *out)
{
    uint8_t fastest_ms = d->board.fastest_stream_ms;
    uint8_t body[LONGEST_BODY];
    d->stream_period_ms = asked_ms != 0 && asked_ms < fastest_ms ? fastest_ms : asked_ms;
    d->until_reading_ms = d->stream_period_ms;
    struct stream_ack m = {.asked_ms = asked_ms, .period_ms = d->stream_period_ms};
    return frame(body, put_stream_ack(&m, body), out);
}

uint8_t device_receive(struct device *d, uint8_t byte, uint32_t now_ms, uint8_t *out)
{
    union {
        struct hello hello;
        struct setpoint setpoint;
        struct stream stream;
    } m;
    const uint8_t *body = d->line.bytes;
    uint8_t length = deframer_take(&d->line, byte);
    if (length == 0)
        return 0;
    if (get_hello(&m.hello, body, length)) {
        d->stream_period_ms = 0;
        safety_greet(&d->safety, m.hello.protocol_major);
        return introduce(d, out);
    }
    if (get_setpoint(&m.setpoint, body, length) && safety_command(&d->safety, &m.setpoint, now_ms))
        return 0;
    if (get_stream(&m.stream, body, length) && d->safety.greeted)
        return set_stream(d, m.stream.period_ms, out);
    d->refused++;
    return 0;
}

uint8_t device_tick(struct device *d, uint32_t now_ms, uint16_t adc, uint8_t overruns, uint8_t *out)
{
    uint8_t body[LONGEST_BODY];
    const struct safety *s = &d->safety;
    if (d->stream_period_ms == 0 || --d->until_reading_ms != 0)
        return 0;
    d->until_reading_ms = d->stream_period_ms;
    struct reading m = {
        .sequence = d->sequence++,
        .uptime_ms = now_ms,
        .boot_id = d->board.boot_id,
        .adc = adc,
        .flags = (uint8_t)((s->greeted ? GREETED : 0) | (s->commanded ? 0 : RETRACTED) |
                           (s->step_limited ? STEP_LIMITED : 0)),
        .applied_sequence = s->applied_sequence,
        .damaged = d->line.damaged,
        .refused = d->refused,
        .overruns = overruns,
    };
    return frame(body, put_reading(&m, body), out);
}
