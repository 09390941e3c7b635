/* hapticnet for C: a master's and a slave's end of the hapticnet protocol.
 *
 * The library does no input or output, reads no clock and allocates nothing. A program gives it datagrams and the time,
 * and sends what it returns. Its README has the smallest master and slave; docs/refer/protocol.md has the protocol. */
#ifndef HAPTICNET_H
#define HAPTICNET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hapticnet_constants.h"

typedef uint32_t hn_entropy(void *context); /* returns 32 unpredictable bits */

typedef struct {
    const char *name; /* of a codec's parameter, or NULL */
    double value;
} hn_parameter;

typedef struct {
    const char *codec, *name; /* how forces are compressed, and who asks; UTF-8 that stays where it is */
    hn_parameter parameters[HN_MOST_PARAMETERS];
    double weber_fraction, floor_n, multiplier; /* the just-noticeable difference of the person at the master */
    double rate_hz;                             /* positions a second */
    unsigned axes;                              /* 1 to 3 */
} hn_request;

typedef enum { HN_CONNECTING, HN_ESTABLISHED, HN_STALE, HN_CLOSING, HN_CLOSED } hn_state;

typedef struct {
    uint32_t malformed, stray, too_old; /* datagrams that were dropped, and answers that came too late */
} hn_counts;

#include "hapticnet_state.h"

/* The master: `rate_hz` times a second, call tick, force and then send, until it returns 0. Call send after receive,
 * too. `init` returns NULL or what is wrong with the request. Without a session, `position_m` is not used. */
const char *hn_master_init(hn_master *m, const hn_request *request, hn_entropy *entropy, void *context);
void hn_master_tick(hn_master *m, const double position_m[], int64_t now_us);
void hn_master_force(hn_master *m, double force_n[], int64_t now_us);
size_t hn_master_send(hn_master *m, uint8_t datagram[HN_DATAGRAM_BYTES]);
void hn_master_receive(hn_master *m, const void *datagram, size_t size, int64_t now_us);
void hn_master_close(hn_master *m, const char *reason, int64_t now_us); /* then go on until the state is CLOSED */

hn_state hn_master_state(const hn_master *m);
const char *hn_master_reason(const hn_master *m, unsigned *code); /* of the newest REFUSE, CLOSE or NOTICE */
const char *hn_master_scene(const hn_master *m);
hn_counts hn_master_counts(const hn_master *m);

#endif
