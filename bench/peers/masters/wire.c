/* See wire.h. */
#include "wire.h"
#include <string.h>

void put_byte(struct writer *to, unsigned byte)
{
    *to->at++ = (uint8_t)byte;
}

static void put_big_endian(struct writer *to, uint64_t value, int bytes)
{
    for (int shift = 8 * (bytes - 1); shift >= 0; shift -= 8)
        put_byte(to, (unsigned)(value >> shift) & 0xff);
}

void put_uint(struct writer *to, uint64_t value)
{
    if (value < 0x80) {
        put_byte(to, (unsigned)value);
        return;
    }
    const int size = value < 1u << 8 ? 0 : value < 1u << 16 ? 1 : value < (uint64_t)1 << 32 ? 2 : 3;
    put_byte(to, 0xccu + (unsigned)size);
    put_big_endian(to, value, 1 << size);
}

void put_double(struct writer *to, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_byte(to, 0xcb);
    put_big_endian(to, bits, 8);
}

void put_bin(struct writer *to, const void *bytes, size_t count)
{
    put_byte(to, count < 256 ? 0xc4 : 0xc5);
    put_big_endian(to, count, count < 256 ? 1 : 2);
    memcpy(to->at, bytes, count);
    to->at += count;
}

void put_text(struct writer *to, const char *text)
{
    const size_t count = strlen(text);
    put_byte(to, 0xa0u | (unsigned)count);
    memcpy(to->at, text, count);
    to->at += count;
}

void put_head(struct writer *to, int version, int kind, uint32_t session, uint32_t sequence)
{
    put_byte(to, 0x95);
    put_byte(to, (unsigned)version);
    put_byte(to, (unsigned)kind);
    put_uint(to, session);
    put_uint(to, sequence);
}

static int get_big_endian(struct reader *from, int bytes, uint64_t *value)
{
    if (from->end - from->at < bytes)
        return -1;
    for (*value = 0; bytes > 0; bytes--)
        *value = *value << 8 | *from->at++;
    return 0;
}

int get_array(struct reader *from, size_t least)
{
    if (from->at == from->end || (*from->at & 0xf0) != 0x90 || (*from->at & 0x0fu) < least)
        return -1;
    from->at++;
    return 0;
}

int get_uint(struct reader *from, uint64_t *value)
{
    if (from->at == from->end)
        return -1;
    const unsigned head = *from->at;
    if (head >= 0x80 && (head < 0xcc || head > 0xcf))
        return -1;
    from->at++;
    *value = head;
    return head < 0x80 ? 0 : get_big_endian(from, 1 << (head - 0xcc), value);
}

int get_uint_or_nil(struct reader *from, uint64_t *value, int *is_nil)
{
    *is_nil = from->at != from->end && *from->at == 0xc0;
    if (!*is_nil)
        return get_uint(from, value);
    from->at++;
    return 0;
}

int get_number(struct reader *from, double *value)
{
    uint64_t bits;
    if (from->at == from->end || (*from->at != 0xca && *from->at != 0xcb)) {
        if (get_uint(from, &bits))
            return -1;
        *value = (double)bits;
        return 0;
    }
    const int bytes = *from->at++ == 0xca ? 4 : 8;
    if (from->end - from->at < bytes)
        return -1;
    *value = bytes == 4 ? load_single(from->at) : load_double(from->at);
    from->at += bytes;
    return 0;
}

int get_bytes(struct reader *from, const uint8_t **bytes, size_t *count)
{
    uint64_t length;
    if (from->at == from->end)
        return -1;
    const unsigned head = *from->at++;
    if ((head & 0xe0) == 0xa0)
        length = head & 0x1f;
    else if ((head != 0xc4 && head != 0xc5 && head != 0xd9 && head != 0xda)
             || get_big_endian(from, head == 0xc4 || head == 0xd9 ? 1 : 2, &length))
        return -1;
    if ((uint64_t)(from->end - from->at) < length)
        return -1;
    *bytes = from->at;
    *count = length;
    from->at += length;
    return 0;
}

int get_bool(struct reader *from, int *value)
{
    if (from->at == from->end || (*from->at & 0xfe) != 0xc2)
        return -1;
    *value = *from->at++ & 1;
    return 0;
}

int read_frame(const uint8_t *data, size_t bytes, struct frame *frame)
{
    struct reader from = {data, data + bytes};
    uint64_t version, kind, session, sequence;
    if (get_array(&from, 5) || get_uint(&from, &version) || get_uint(&from, &kind) || get_uint(&from, &session)
        || get_uint(&from, &sequence) || version > 2 || kind > COOKIE || session >> 32 || sequence >> 32)
        return -1;
    frame->head_bytes = (size_t)(from.at - data);
    frame->version = (int)version;
    frame->kind = (int)kind;
    frame->session = (uint32_t)session;
    frame->sequence = (uint32_t)sequence;
    return get_bytes(&from, &frame->body, &frame->body_bytes) || from.at != from.end ? -1 : 0;
}

uint32_t load_u32(const uint8_t *from)
{
    return (uint32_t)from[0] << 24 | (uint32_t)from[1] << 16 | (uint32_t)from[2] << 8 | from[3];
}

void store_u32(uint8_t *to, uint32_t value)
{
    to[0] = (uint8_t)(value >> 24);
    to[1] = (uint8_t)(value >> 16);
    to[2] = (uint8_t)(value >> 8);
    to[3] = (uint8_t)value;
}

void store_single(uint8_t *to, double value)
{
    const float single = (float)value;
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    store_u32(to, bits);
}

double load_single(const uint8_t *from)
{
    const uint32_t bits = load_u32(from);
    float single;
    memcpy(&single, &bits, sizeof single);
    return (double)single;
}

double load_double(const uint8_t *from)
{
    const uint64_t bits = (uint64_t)load_u32(from) << 32 | load_u32(from + 4);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* float16 of a number between 2^-14 and 65504 in size, cut to 10 bits; smaller ones become 0. */
void store_half(uint8_t *to, double value)
{
    const float single = (float)value;
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    const int exponent = (int)(bits >> 23 & 0xff) - 127 + 15;
    const uint32_t half = exponent < 1 ? 0 : (bits >> 16 & 0x8000) | (uint32_t)exponent << 10 | (bits >> 13 & 0x3ff);
    to[0] = (uint8_t)(half >> 8);
    to[1] = (uint8_t)half;
}
