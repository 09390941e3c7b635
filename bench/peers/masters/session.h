/* One master: it asks for a session, sends positions, and reads, checks and acknowledges what comes back. */
#ifndef MASTERS_SESSION_H
#define MASTERS_SESSION_H
#include "seal.h"
#include "wire.h"

enum state { ABSENT, ASKING, ESTABLISHED, CLOSING, CLOSED };

struct wanted { /* the same for all masters */
    const char *codec;
    double rate_hz, share;
    int sealed, echoed; /* echoed: there is no slave, and positions come back as they are */
};

struct master {
    enum state state;
    unsigned index;
    uint32_t nonce, session, sequence; /* the sequence of the next datagram */
    uint8_t cookie[COOKIE_BYTES], mac[MAC_BYTES];
    uint8_t request[NOISE1_MORE + 160];
    size_t request_bytes;
    int has_cookie, has_force, has_confirmed;
    uint32_t newest, newest_force, confirmed; /* confirmed: what a POSITION acknowledges */
    uint64_t began_ns, said_ns;
    double phase;
    struct noise noise;
    struct seal seal;
};

enum { TRIP_BINS = 1 << 18 }; /* round trips in bins of 1 us; the last one holds all longer ones, too */

struct counts {
    uint64_t positions, sent_bytes, received, received_bytes, answers, forces, keepalives;
    uint64_t lost, late, malformed, refused, ended, resets, closed;
    double greatest_n;
    uint64_t trips[TRIP_BINS];
};

extern struct counts counts;
extern struct wanted wanted;

/* Answers to positions before this time [us, 32 bits] are not counted among the answers. */
extern uint32_t counted_from_us;

void master_ask(struct master *master, uint64_t now); /* begin, or say the HELLO again */
void master_position(struct master *master, uint64_t now);
void master_close(struct master *master);
void master_take(struct master *master, uint8_t *data, size_t bytes, uint64_t now);
#endif
