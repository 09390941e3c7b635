/* Datagrams and their bodies: docs/refer/protocol.md, "The frame" and "Messages".
 *
 * What reads returns whether the protocol allows it; bytes and texts then point into the datagram. What writes returns
 * the size of the datagram, which has room for HN_DATAGRAM_BYTES. */
#ifndef HN_MESSAGES_H
#define HN_MESSAGES_H

#include "pack.h"

typedef struct {
    uint32_t version, kind, session, sequence;
    hn_bytes body;
} hn_frame;

typedef struct {
    hn_bytes name;
    double value;
} hn_named;

typedef struct {
    uint32_t nonce;
    hn_bytes cookie, request, mac;
} hn_hello;

typedef struct {
    hn_bytes codec;
    unsigned count;
    hn_named parameters[HN_MOST_ELEMENTS];
    double weber_fraction, floor_n, multiplier, rate_hz;
    unsigned axes;
    hn_bytes name, ticket;
    uint64_t clock_us;
    bool announced;
    double position_share;
    bool predicted, coupled, vibrates, has_parts;
    double vibration_budget, vibration_threshold; /* [B/s], [m/s^2] */
} hn_asked;

typedef struct {
    uint32_t session;
    double rate_hz;
    uint32_t keepalive_us;
    hn_bytes scene, ticket;
    bool resumed, announced;
    double position_share;
    bool predicted, vibrates;
    hn_bytes frame; /* where the scene's axes point, in words */
} hn_grant;

typedef struct {
    uint32_t nonce;
    hn_bytes bytes;
} hn_answer; /* a COOKIE, or a WELCOME with its grant */

typedef struct {
    uint32_t nonce; /* of a REFUSE */
    hn_bytes reason;
    uint32_t code;
    bool has_shapes; /* of a NOTICE that shows how the scene looks */
} hn_ending; /* a REFUSE, CLOSE or NOTICE */

typedef struct {
    uint32_t t_us;
    hn_maybe newest;
    hn_bytes payload;
    bool reports;
    uint32_t share, again, waited_ms; /* [%], [%], [ms] */
} hn_position;

typedef struct {
    uint32_t t_us;
    hn_bytes payload, bound; /* of few positions; NULL: none */
} hn_force;

typedef struct {
    uint32_t t_us;
    hn_maybe newest_force;
    hn_bytes bound;
} hn_keepalive;

bool hn_read_frame(hn_bytes data, hn_frame *frame);
bool hn_read_nonce(hn_bytes body, uint32_t *nonce);
bool hn_read_hello(hn_bytes body, hn_hello *hello);
bool hn_read_asked(hn_bytes packed, hn_asked *asked);
bool hn_read_answer(hn_bytes body, uint32_t kind, hn_answer *answer);
bool hn_read_grant(hn_bytes packed, hn_grant *grant);
bool hn_read_ending(hn_bytes body, uint32_t kind, hn_ending *ending);
bool hn_read_position(hn_bytes body, hn_position *position);
bool hn_read_force(hn_bytes body, hn_force *force);
bool hn_read_keepalive(hn_bytes body, hn_keepalive *keepalive);

size_t hn_write_frame(uint8_t *data, uint32_t kind, uint32_t session, uint32_t sequence, hn_bytes body);
size_t hn_write_hello(uint8_t *data, uint32_t sequence, const hn_hello *hello);
size_t hn_write_answer(uint8_t *data, uint32_t kind, uint32_t session, uint32_t sequence, const hn_answer *answer);
size_t hn_write_ending(uint8_t *data, uint32_t kind, uint32_t session, uint32_t sequence, const hn_ending *ending);
size_t hn_write_position(uint8_t *data, uint32_t session, uint32_t sequence, const hn_position *position);
size_t hn_write_force(uint8_t *data, uint32_t session, uint32_t sequence, const hn_force *force);
size_t hn_write_keepalive(uint8_t *data, uint32_t session, uint32_t sequence, const hn_keepalive *keepalive);
hn_bytes hn_pack_asked(uint8_t *packed, size_t size, const hn_asked *asked);
hn_bytes hn_pack_grant(uint8_t *packed, size_t size, const hn_grant *grant);

hn_bytes hn_text(const char *text);
/* Copy a text that was read, with a zero after it; `size` is that of the copy. */
void hn_copy_text(char *copy, size_t size, hn_bytes text);

/* How far `newer` is ahead of `older`, -2^31 to 2^31 - 1, and the number nearest to `near` with these low bits. */
int64_t hn_distance(uint32_t newer, uint32_t older);
int64_t hn_unwrap(uint32_t number, int64_t near);

#endif
