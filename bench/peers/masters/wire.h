/* Datagrams of hapticnet's protocol (docs/refer/protocol.md) as this load generator writes and reads them: msgpack, by hand. */
#ifndef MASTERS_WIRE_H
#define MASTERS_WIRE_H
#include <stddef.h>
#include <stdint.h>

enum kind { HELLO = 1, WELCOME, REFUSE, POSITION, FORCE, KEEPALIVE, CLOSE, RESET, COOKIE };
enum { OPEN_VERSION = 1, SEALED_VERSION = 2, MOST_BYTES = 1200, COOKIE_BYTES = 16, MAC_BYTES = 16 };

/* Where the next value is written or read. The caller makes sure that a writer has room; a reader stops at `end`. */
struct writer {
    uint8_t *at;
};
struct reader {
    const uint8_t *at, *end;
};

struct frame {
    int version, kind;
    uint32_t session, sequence;
    const uint8_t *body;
    size_t body_bytes, head_bytes; /* the head is what a seal authenticates: all before the body's own head */
};

void put_byte(struct writer *to, unsigned byte);
void put_uint(struct writer *to, uint64_t value);
void put_double(struct writer *to, double value);
void put_bin(struct writer *to, const void *bytes, size_t count);
void put_text(struct writer *to, const char *text); /* at most 31 bytes */
void put_head(struct writer *to, int version, int kind, uint32_t session, uint32_t sequence);

/* Return 0, or -1 if the value is of another type or does not fit. */
int get_array(struct reader *from, size_t least);
int get_uint(struct reader *from, uint64_t *value);
int get_uint_or_nil(struct reader *from, uint64_t *value, int *is_nil);
int get_number(struct reader *from, double *value);
int get_bytes(struct reader *from, const uint8_t **bytes, size_t *count); /* bin or text */
int get_bool(struct reader *from, int *value);
int read_frame(const uint8_t *data, size_t bytes, struct frame *frame);

uint32_t load_u32(const uint8_t *from);
void store_u32(uint8_t *to, uint32_t value);
void store_single(uint8_t *to, double value);
double load_single(const uint8_t *from);
double load_double(const uint8_t *from);
void store_half(uint8_t *to, double value);
#endif
