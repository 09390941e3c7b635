/* Frames on the serial line: a message and its CRC-16/CCITT-FALSE, COBS-encoded and terminated by a zero byte. */
#ifndef FRAMING_H
#define FRAMING_H

#include <stdbool.h>
#include <stdint.h>

#define LONGEST_BODY 48u                  /* bytes, kind included */
#define LONGEST_FRAME (LONGEST_BODY + 3u) /* bytes without the delimiter: 2 of CRC, 1 of COBS */

struct deframer {
    uint8_t bytes[LONGEST_BODY + 2u]; /* decoded so far */
    uint8_t length;
    uint8_t until_zero; /* bytes before the next encoded zero; 0 before the first byte of a frame */
    bool bad;           /* too long, or early delimiter: skip to the next delimiter */
    uint8_t damaged;    /* dropped frames, modulo 256 */
};

uint16_t crc16(const uint8_t *bytes, uint8_t length);

/* Process one byte; return the length of the message it completes, in d->bytes until the next call, or 0. */
uint8_t deframer_take(struct deframer *d, uint8_t byte);

/* Write the frame of a body with its delimiter to out[LONGEST_FRAME + 1]; return its length. */
uint8_t frame(const uint8_t *body, uint8_t length, uint8_t *out);

#endif
