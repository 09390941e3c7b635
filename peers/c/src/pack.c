#include "pack.h"

#include <float.h>
#include <math.h>
#include <string.h>

hn_writer hn_write_to(uint8_t *data, size_t size)
{
    return (hn_writer){data, data + size, true};
}

static void put(hn_writer *w, const void *data, size_t size)
{
    if (!w->ok || (size_t)(w->end - w->at) < size) {
        w->ok = false;
        return;
    }
    if (size > 0)
        memcpy(w->at, data, size);
    w->at += size;
}

/* A head of one byte, and a big-endian number after it. */
static void put_head(hn_writer *w, unsigned head, uint64_t number, unsigned size)
{
    uint8_t bytes[9] = {(uint8_t)head};
    for (unsigned i = 0; i < size; i++)
        bytes[1 + i] = (uint8_t)(number >> 8 * (size - 1 - i));
    put(w, bytes, 1 + size);
}

void hn_put_nil(hn_writer *w)
{
    put_head(w, 0xc0, 0, 0);
}

void hn_put_bool(hn_writer *w, bool value)
{
    put_head(w, value ? 0xc3 : 0xc2, 0, 0);
}

void hn_put_uint(hn_writer *w, uint64_t value)
{
    if (value < 0x80)
        put_head(w, (unsigned)value, 0, 0);
    else if (value <= UINT8_MAX)
        put_head(w, 0xcc, value, 1);
    else if (value <= UINT16_MAX)
        put_head(w, 0xcd, value, 2);
    else if (value <= UINT32_MAX)
        put_head(w, 0xce, value, 4);
    else
        put_head(w, 0xcf, value, 8);
}

void hn_put_maybe(hn_writer *w, hn_maybe value)
{
    if (value.is_set)
        hn_put_uint(w, value.value);
    else
        hn_put_nil(w);
}

void hn_put_double(hn_writer *w, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_head(w, 0xcb, bits, 8);
}

void hn_put_bytes(hn_writer *w, const void *data, size_t size)
{
    put_head(w, size <= UINT8_MAX ? 0xc4 : 0xc5, size, size <= UINT8_MAX ? 1 : 2);
    put(w, data, size);
}

void hn_put_text(hn_writer *w, const char *text, size_t size)
{
    put_head(w, size < 32 ? 0xa0 + (unsigned)size : 0xd9, size, size < 32 ? 0 : 1);
    put(w, text, size);
}

void hn_put_array(hn_writer *w, unsigned elements)
{
    put_head(w, 0x90 + elements, 0, 0);
}

void hn_put_map(hn_writer *w, unsigned pairs)
{
    put_head(w, 0x80 + pairs, 0, 0);
}

/* A value as it was read; `size` of an array is its number of elements, of a map that of its keys and values. */
typedef struct {
    enum { WRONG, NIL, BOOL, UINT, NEGATIVE, REAL, TEXT, BYTES, ARRAY, MAP } type;
    uint64_t number;
    double real;
    hn_bytes bytes;
    size_t size;
} item;

hn_reader hn_read_from(hn_bytes data)
{
    return (hn_reader){data.at, data.at + data.size, true};
}

static bool fail(hn_reader *r)
{
    r->ok = false;
    return false;
}

static hn_bytes take(hn_reader *r, size_t size)
{
    hn_bytes taken = {r->at, size};
    if (!r->ok || (size_t)(r->end - r->at) < size) {
        fail(r);
        return (hn_bytes){NULL, 0};
    }
    r->at += size;
    return taken;
}

static uint64_t big_endian(hn_reader *r, size_t size)
{
    hn_bytes taken = take(r, size);
    uint64_t value = 0;
    for (size_t i = 0; i < taken.size; i++)
        value = value << 8 | taken.at[i];
    return value;
}

/* Return a code point of UTF-8 and move on; fail if there is none. */
static uint32_t code_point(hn_reader *r)
{
    static const uint32_t least[] = {0, 0x80, 0x800, 0x10000};
    uint32_t c = (uint32_t)big_endian(r, 1);
    unsigned more = c < 0x80 ? 0 : c < 0xc0 ? 4 : c < 0xe0 ? 1 : c < 0xf0 ? 2 : c < 0xf8 ? 3 : 4;
    if (more == 4)
        return fail(r);
    c &= more == 0 ? 0x7f : 0x3fu >> more;
    for (unsigned i = 0; i < more; i++) {
        uint32_t next = (uint32_t)big_endian(r, 1);
        if ((next & 0xc0) != 0x80)
            return fail(r);
        c = c << 6 | (next & 0x3f);
    }
    if (c < least[more] || c > 0x10ffff || (0xd800 <= c && c < 0xe000))
        return fail(r);
    return c;
}

/* Whether a terminal would not print it: the categories C and Z of Unicode 14, except the space and what is not
 * assigned. */
static bool is_hidden(uint32_t c)
{
    static const uint32_t ranges[][2] = {
        {0x0000, 0x001f}, {0x007f, 0x00a0}, {0x00ad, 0x00ad}, {0x0600, 0x0605}, {0x061c, 0x061c}, {0x06dd, 0x06dd},
        {0x070f, 0x070f}, {0x0890, 0x0891}, {0x08e2, 0x08e2}, {0x1680, 0x1680}, {0x180e, 0x180e}, {0x2000, 0x200f},
        {0x2028, 0x202f}, {0x205f, 0x2064}, {0x2066, 0x206f}, {0x3000, 0x3000}, {0xd800, 0xf8ff}, {0xfeff, 0xfeff},
        {0xfff9, 0xfffb}, {0x110bd, 0x110bd}, {0x110cd, 0x110cd}, {0x13430, 0x13438}, {0x1bca0, 0x1bca3},
        {0x1d173, 0x1d17a}, {0xe0001, 0xe0001}, {0xe0020, 0xe007f}, {0xf0000, 0xffffd}, {0x100000, 0x10fffd},
    };
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++)
        if (c <= ranges[i][1])
            return c >= ranges[i][0];
    return false;
}

/* Whether it is UTF-8 and, if `shown`, nothing in it is hidden. */
static bool is_utf8(hn_bytes text, bool shown)
{
    hn_reader r = hn_read_from(text);
    while (r.ok && r.at < r.end)
        if (is_hidden(code_point(&r)) && shown)
            return false;
    return r.ok;
}

bool hn_is_text(hn_bytes text, size_t most)
{
    return text.size <= most && is_utf8(text, true);
}

static item get_integer(hn_reader *r, unsigned size, bool is_signed)
{
    uint64_t number = big_endian(r, size);
    if (is_signed && number >> (8 * size - 1)) {
        uint64_t below = (~number & (UINT64_MAX >> (64 - 8 * size))) + 1;
        return (item){.type = NEGATIVE, .real = -(double)below};
    }
    return (item){.type = UINT, .number = number, .real = (double)number};
}

static item get_real(hn_reader *r, unsigned size)
{
    uint64_t bits = big_endian(r, size);
    item found = {.type = REAL};
    if (size == 4) {
        uint32_t low = (uint32_t)bits;
        float single;
        memcpy(&single, &low, sizeof single);
        found.real = (double)single;
    } else {
        memcpy(&found.real, &bits, sizeof bits);
    }
    return found;
}

static item get_bytes(hn_reader *r, size_t size, bool text)
{
    item found = {.type = text ? TEXT : BYTES, .bytes = take(r, size)};
    if (text && r->ok && !is_utf8(found.bytes, false))
        fail(r);
    return found;
}

static item get_group(hn_reader *r, size_t elements, bool map)
{
    if (elements > HN_MOST_ELEMENTS)
        fail(r);
    return (item){.type = map ? MAP : ARRAY, .size = map ? 2 * elements : elements};
}

static item get_item(hn_reader *r)
{
    unsigned head = (unsigned)big_endian(r, 1);
    if (head < 0x80)
        return (item){.type = UINT, .number = head, .real = head};
    if (head < 0xa0)
        return get_group(r, head & 0x0f, head < 0x90);
    if (head < 0xc0)
        return get_bytes(r, head & 0x1f, true);
    if (head >= 0xe0)
        return (item){.type = NEGATIVE, .real = (double)head - 256};
    switch (head) {
    case 0xc0:
        return (item){.type = NIL};
    case 0xc2:
    case 0xc3:
        return (item){.type = BOOL, .number = head & 1};
    case 0xc4:
    case 0xc5:
    case 0xc6:
        return get_bytes(r, big_endian(r, 1u << (head - 0xc4)), false);
    case 0xca:
    case 0xcb:
        return get_real(r, head == 0xca ? 4 : 8);
    case 0xcc:
    case 0xcd:
    case 0xce:
    case 0xcf:
        return get_integer(r, 1u << (head - 0xcc), false);
    case 0xd0:
    case 0xd1:
    case 0xd2:
    case 0xd3:
        return get_integer(r, 1u << (head - 0xd0), true);
    case 0xd9:
    case 0xda:
    case 0xdb:
        return get_bytes(r, big_endian(r, 1u << (head - 0xd9)), true);
    case 0xdc:
    case 0xdd:
    case 0xde:
    case 0xdf:
        return get_group(r, big_endian(r, head & 1 ? 4 : 2), head >= 0xde);
    default: /* extensions, and what msgpack does not use */
        fail(r);
        return (item){.type = WRONG};
    }
}

static item expect(hn_reader *r, bool good, item found)
{
    if (good && r->ok)
        return found;
    fail(r);
    return (item){.type = WRONG};
}

bool hn_get_nil(hn_reader *r)
{
    bool is_nil = r->ok && r->at < r->end && *r->at == 0xc0;
    r->at += is_nil;
    return is_nil;
}

bool hn_get_bool(hn_reader *r)
{
    item found = get_item(r);
    return expect(r, found.type == BOOL, found).number;
}

uint64_t hn_get_uint(hn_reader *r, uint64_t most)
{
    item found = get_item(r);
    return expect(r, found.type == UINT && found.number <= most, found).number;
}

uint32_t hn_get_uint32(hn_reader *r)
{
    return (uint32_t)hn_get_uint(r, UINT32_MAX);
}

hn_maybe hn_get_maybe(hn_reader *r)
{
    if (hn_get_nil(r))
        return (hn_maybe){false, 0};
    return (hn_maybe){true, hn_get_uint32(r)};
}

double hn_get_number(hn_reader *r)
{
    item found = get_item(r);
    bool good = found.type == UINT || found.type == NEGATIVE || (found.type == REAL && fabs(found.real) <= DBL_MAX);
    return expect(r, good, found).real;
}

hn_bytes hn_get_bytes(hn_reader *r)
{
    item found = get_item(r);
    return expect(r, found.type == BYTES, found).bytes;
}

hn_bytes hn_get_text(hn_reader *r, size_t most)
{
    item found = get_item(r);
    return expect(r, found.type == TEXT && r->ok && hn_is_text(found.bytes, most), found).bytes;
}

unsigned hn_get_map(hn_reader *r)
{
    item found = get_item(r);
    return (unsigned)expect(r, found.type == MAP, found).size / 2;
}

unsigned hn_get_array(hn_reader *r, unsigned least)
{
    item found = get_item(r);
    return (unsigned)expect(r, found.type == ARRAY && found.size >= least, found).size;
}

bool hn_get_end(hn_reader *r, unsigned elements)
{
    for (size_t left = elements; left > 0 && r->ok; left--)
        left += get_item(r).size;
    return r->ok && (r->at == r->end || fail(r));
}
