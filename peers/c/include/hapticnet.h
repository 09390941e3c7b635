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

#ifdef __cplusplus
extern "C" {
#endif

struct hn_more;
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
    double position_share; /* of that difference, for few positions: 0.01 to 0.9; 0: every position is sent */
    bool announced, predicted; /* whether to render contact that the slave announces; whether it predicts the hand */
    struct hn_more *more;      /* memory for these and for codecs that follow the hand; NULL if there is none */
} hn_request;

typedef enum { HN_CONNECTING, HN_ESTABLISHED, HN_STALE, HN_CLOSING, HN_CLOSED } hn_state;

typedef struct {
    uint32_t malformed, stray, too_old; /* datagrams that were dropped, and answers that came too late */
} hn_counts;

enum { HN_ADDRESS_BYTES = 28 }; /* as large as a sockaddr_in6 */

#include "hapticnet_state.h"

/* The master: `rate_hz` times a second, call tick, force and then send, until it returns 0. Call send after receive,
 * too. `init` returns NULL or what is wrong with the request: "rate_hz must be between 20 and 100000"; `hn_say_wrong`
 * writes it with the request's value: "rate_hz is 5; it must be ...". Without a session, `position_m` is not used. */
const char *hn_master_init(hn_master *m, const hn_request *request, hn_entropy *entropy, void *context);
const char *hn_say_wrong(const hn_request *request, const char *wrong, char *text, size_t size);
void hn_master_tick(hn_master *m, const double position_m[], int64_t now_us);
void hn_master_force(hn_master *m, double force_n[], int64_t now_us);
size_t hn_master_send(hn_master *m, uint8_t datagram[HN_DATAGRAM_BYTES]);
void hn_master_receive(hn_master *m, const void *datagram, size_t size, int64_t now_us);
void hn_master_close(hn_master *m, const char *reason, int64_t now_us); /* then go on until the state is CLOSED */

/* Few positions, announced contact and codecs that follow the hand need `hn_more_bytes` of memory, aligned as a double.
 * Before `hn_master_init`, set the request's `more` to what `hn_more_init` makes of it: NULL if the memory is NULL or not
 * aligned, or none is needed. It belongs to one master, and to this request: one that is changed later is refused. */
size_t hn_more_bytes(const hn_request *request);
struct hn_more *hn_more_init(void *memory, const hn_request *request);

hn_state hn_master_state(const hn_master *m);
const char *hn_master_reason(const hn_master *m, unsigned *code); /* of the newest REFUSE, CLOSE or NOTICE */
const char *hn_master_scene(const hn_master *m);
hn_counts hn_master_counts(const hn_master *m);

/* The slave, of one master at a time, with the codecs deadband and raw. `receive` returns the size of an answer to
 * where the datagram came from, or 0. When all that has arrived was received and `position` returns true, give `answer`
 * the force there; what that returns goes to `hn_slave_master`. A force that is not finite closes the session. `init`
 * returns NULL or what is wrong. */
const char *hn_slave_init(hn_slave *s, const char *scene, unsigned axes, hn_entropy *entropy, void *context);
size_t hn_slave_receive(hn_slave *s, const void *datagram, size_t size, const void *address, size_t address_size,
                        int64_t now_us, uint8_t answer[HN_DATAGRAM_BYTES]);
bool hn_slave_position(const hn_slave *s, double position_m[]);
size_t hn_slave_answer(hn_slave *s, const double force_n[], int64_t now_us, uint8_t answer[HN_DATAGRAM_BYTES]);
size_t hn_slave_close(hn_slave *s, const char *reason, unsigned code, uint8_t datagram[HN_DATAGRAM_BYTES]);

const void *hn_slave_master(const hn_slave *s, size_t *size); /* the address of the session's master, or NULL */
hn_counts hn_slave_counts(const hn_slave *s);

#ifdef __cplusplus
}
#endif

#endif
