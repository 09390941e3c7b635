/* The device: bytes, milliseconds and servo frames in; frames for the host and pulses out. No clocks, no registers. */
#ifndef DEVICE_H
#define DEVICE_H

#include "framing.h"
#include "safety.h"

#define FIRMWARE_MAJOR 0
#define FIRMWARE_MINOR 1
#define FIRMWARE_PATCH 0

/* Properties of the board. */
struct board {
    uint32_t clock_hz;
    uint16_t boot_id;
    uint8_t reset_cause;
    uint8_t adc_bits;
    uint8_t fastest_stream_ms; /* shortest period of readings the line can carry */
};

struct device {
    struct board board;
    struct deframer line;
    struct safety safety;
    uint8_t stream_period_ms; /* 0: no readings */
    uint8_t until_reading_ms;
    uint16_t sequence; /* number of the next reading */
    uint8_t refused;   /* refused messages, modulo 256 */
};

void device_start(struct device *d, const struct board *board, uint32_t now_ms);

/* Process one byte from the host; return the length of the answer in out[LONGEST_FRAME + 1], or 0. */
uint8_t device_receive(struct device *d, uint8_t byte, uint32_t now_ms, uint8_t *out);

/* Process a new millisecond; return the length of the reading in out[LONGEST_FRAME + 1], or 0. `adc` is in 1/64 count,
 * `overruns` is the number of bytes the board lost. */
uint8_t device_tick(struct device *d, uint32_t now_ms, uint16_t adc, uint8_t overruns, uint8_t *out);

#endif
