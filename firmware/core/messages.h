/* Messages between host and firmware: kind first, little-endian, fixed lengths. The layouts are in
 * hapticnet/device/messages.py; tests/vectors/device.json tests both sides. */
#ifndef MESSAGES_H
#define MESSAGES_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"

#define PROTOCOL_MAJOR 1
#define PROTOCOL_MINOR 0

#define ADC_FRACTION 64u /* an averaged reading is in 1/64 count */

enum kind { HELLO = 0x01, SETPOINT = 0x02, STREAM = 0x03, IDENTITY = 0x81, READING = 0x82, STREAM_ACK = 0x83 };

enum flag { GREETED = 1, RETRACTED = 2, STEP_LIMITED = 4 };

struct hello {
    uint8_t protocol_major, protocol_minor;
};

struct setpoint {
    uint16_t sequence;
    uint16_t pulses[SERVOS]; /* ticks of 0.5 us */
};

struct stream {
    uint8_t period_ms;
};

struct identity {
    uint8_t protocol_major, protocol_minor;
    uint8_t firmware_major, firmware_minor, firmware_patch;
    uint8_t reset_cause; /* MCUSR */
    uint16_t boot_id;
    uint32_t clock_hz;
    uint16_t limits[SERVOS][2]; /* shortest and longest pulse, ticks of 0.5 us */
    uint16_t largest_step;      /* ticks of 0.5 us per frame */
    uint8_t adc_bits;
};

struct reading {
    uint16_t sequence;
    uint32_t uptime_ms;
    uint16_t boot_id;
    uint16_t adc; /* 1/64 count */
    uint8_t flags;
    uint16_t applied_sequence;
    uint8_t damaged, refused, overruns; /* modulo 256 */
};

struct stream_ack {
    uint8_t asked_ms, period_ms;
};

/* Decode a message; return false for an unknown kind or a wrong length. */
bool get_hello(struct hello *m, const uint8_t *body, uint8_t length);
bool get_setpoint(struct setpoint *m, const uint8_t *body, uint8_t length);
bool get_stream(struct stream *m, const uint8_t *body, uint8_t length);

/* Encode a message to body[LONGEST_BODY]; return its length. */
uint8_t put_identity(const struct identity *m, uint8_t *body);
uint8_t put_reading(const struct reading *m, uint8_t *body);
uint8_t put_stream_ack(const struct stream_ack *m, uint8_t *body);

#endif
