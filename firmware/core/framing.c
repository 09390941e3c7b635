/* COBS and CRC, one byte at a time and without a table, which would take 512 bytes of flash to save 10 us. */
#include "framing.h"

uint16_t crc16(const uint8_t *bytes, uint8_t length)
{
    uint16_t crc = 0xFFFFu;
    while (length--) {
        uint8_t x = (uint8_t)((crc >> 8) ^ *bytes++);
        x = (uint8_t)(x ^ (x >> 4));
        crc = (uint16_t)((crc << 8) ^ ((uint16_t)x << 12) ^ ((uint16_t)x << 5) ^ x);
    }
    return crc;
}

static void deframer_restart(struct deframer *d)
{
    d->length = 0;
    d->until_zero = 0;
    d->bad = false;
}

static void put(struct deframer *d, uint8_t byte)
{
    if (d->length < sizeof d->bytes)
        d->bytes[d->length++] = byte;
    else
        d->bad = true;
}

/* The zero after the last block is the end of the frame, not a zero in it. */
static uint8_t deframer_end(struct deframer *d)
{
    uint8_t length = d->length;
    bool empty = length == 0 && d->until_zero == 0 && !d->bad;
    bool whole = !d->bad && d->until_zero == 1 && length > 2;
    deframer_restart(d);
    if (whole) {
        length = (uint8_t)(length - 2);
        uint16_t crc = (uint16_t)(d->bytes[length] | (uint16_t)d->bytes[length + 1] << 8);
        if (crc == crc16(d->bytes, length))
            return length;
    }
    if (!empty)
        d->damaged++;
    return 0;
}

uint8_t deframer_take(struct deframer *d, uint8_t byte)
{
    if (byte == 0)
        return deframer_end(d);
    if (d->until_zero == 0) {
        d->until_zero = byte;
    } else if (d->until_zero == 1) {
        put(d, 0);
        d->until_zero = byte;
    } else {
        put(d, byte);
        d->until_zero--;
    }
    return 0;
}

uint8_t frame(const uint8_t *body, uint8_t length, uint8_t *out)
{
    uint16_t crc = crc16(body, length);
    uint8_t code_at = 0, at = 1;
    for (uint8_t i = 0; i < length + 2u; i++) {
        uint8_t byte = i < length ? body[i] : i == length ? (uint8_t)crc : (uint8_t)(crc >> 8);
        if (byte == 0) {
            out[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        } else {
            out[at++] = byte;
        }
    }
    out[code_at] = (uint8_t)(at - code_at);
    out[at++] = 0;
    return at;
}
