/* The part of msgpack that the protocol uses.
 *
 * A reader or writer that has failed stays failed, and its functions then return zero or do nothing. So read or write
 * all fields, and look at `ok` once. */
#ifndef HN_PACK_H
#define HN_PACK_H

#include "hapticnet.h"

typedef struct {
    const uint8_t *at;
    size_t size;
} hn_bytes; /* somewhere in a datagram */

typedef struct {
    uint8_t *at, *end;
    bool ok;
} hn_writer;

typedef struct {
    const uint8_t *at, *end;
    bool ok;
} hn_reader;

hn_writer hn_write_to(uint8_t *data, size_t size);
void hn_put_nil(hn_writer *w);
void hn_put_bool(hn_writer *w, bool value);
void hn_put_uint(hn_writer *w, uint64_t value);
void hn_put_maybe(hn_writer *w, hn_maybe value);
void hn_put_double(hn_writer *w, double value);
void hn_put_bytes(hn_writer *w, const void *data, size_t size);
void hn_put_text(hn_writer *w, const char *text, size_t size); /* at most 255 bytes */
void hn_put_array(hn_writer *w, unsigned elements);            /* at most 15 */
void hn_put_map(hn_writer *w, unsigned pairs);

bool hn_is_text(hn_bytes text, size_t most); /* UTF-8 that a terminal prints */

hn_reader hn_read_from(hn_bytes data);
bool hn_get_nil(hn_reader *r); /* whether the next value is nil; if not, it stays */
bool hn_get_bool(hn_reader *r);
uint64_t hn_get_uint(hn_reader *r, uint64_t most);
uint32_t hn_get_uint32(hn_reader *r);
hn_maybe hn_get_maybe(hn_reader *r);
double hn_get_number(hn_reader *r);               /* an integer too; it is finite */
hn_bytes hn_get_bytes(hn_reader *r);
hn_bytes hn_get_text(hn_reader *r, size_t most);  /* printable */
unsigned hn_get_map(hn_reader *r);
unsigned hn_get_array(hn_reader *r, unsigned least); /* the number of elements */
bool hn_get_end(hn_reader *r, unsigned elements); /* whether nothing follows but `elements` values to ignore */

#endif
