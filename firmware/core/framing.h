/* Frames on the serial line: a message and its CRC-16/CCITT-FALSE in COBS, ended by a zero byte. */
#ifndef FRAMING_H
#define FRAMING_H

#include <stdbool.h>
#include <stdint.h>

#define LONGEST_BODY 48u                  /* bytes, kind included */
#define LONGEST_FRAME (LONGEST_BODY + 3u) /* bytes without the delimiter: 2 of CRC, 1 of COBS */

struct deframer {
    uint8_t bytes[LONGEST_BODY + 2u]; /* unstuffed so far */
    uint8_t length;
    uint8_t until_zero; /* bytes to come before the next stuffed zero; 0 before the first byte of a frame */
    bool bad;           /* too long, or a delimiter came too soon: wait for the next */
    uint8_t damaged;    /* frames dropped; wraps */
};

uint16_t crc16(const uint8_t *bytes, uint8_t length);

/* Take one byte. Returns the length of the message it completes, which stands in d->bytes until the next call, or 0. */
uint8_t deframer_take(struct deframer *d, uint8_t byte);

/* Write the frame of a body, delimiter included, to out[LONGEST_FRAME + 1]; returns its length. */
uint8_t frame(const uint8_t *body, uint8_t length, uint8_t *out);

#endif
