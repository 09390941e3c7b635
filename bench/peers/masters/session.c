/* See session.h. Left out of what docs/refer/protocol.md asks of a master: reports of loss, STALE, asking for another session,
   new keys after 2^20 datagrams. None of them occurs in a run without loss that is shorter than a quarter of an hour. */
#include "session.h"
#include "link.h"
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>

enum { LEAST_HELLO = 400, LATEST_ANSWER_US = 1000000, SEAL_EPOCH = 1 << 20 };

/* The person of the paper (hapticnet/perception.py). */
static const double WEBER_FRACTION = 0.05, FLOOR_N = 0.025, LARGEST_N = 100.0, LONGEST_ATTEMPT_NS = 4e9;

/* The hand: a sine through the paper's tissues, with a phase for each master. */
static const double HAND_HZ = 0.4, HAND_M = 0.035, TURN = 6.283185307179586;

struct counts counts;
struct wanted wanted;
uint32_t counted_from_us;

static void begin(struct master *master, uint64_t now)
{
    uint8_t plain[160];
    char name[16]; /* names differ, because a silent session of one key and name is continued by the next */
    struct writer to = {plain};
    snprintf(name, sizeof name, "bench-%u", master->index);
    put_byte(&to, 0x9c);
    put_text(&to, wanted.codec);
    put_byte(&to, 0x80); /* no parameters */
    put_double(&to, WEBER_FRACTION);
    put_double(&to, FLOOR_N);
    put_double(&to, 1.0);
    put_double(&to, wanted.rate_hz);
    put_uint(&to, 1);
    put_text(&to, name);
    put_byte(&to, 0xc0); /* no ticket */
    put_uint(&to, now / 1000);
    put_byte(&to, 0xc2); /* nothing announced */
    put_double(&to, wanted.share);
    const size_t bytes = (size_t)(to.at - plain);
    if (getrandom(&master->nonce, sizeof master->nonce, 0) != sizeof master->nonce)
        master->nonce = (uint32_t)now;
    if (wanted.sealed) {
        noise_write(&master->noise, master->nonce, plain, bytes, master->request, master->mac);
        master->request_bytes = bytes + NOISE1_MORE;
    } else {
        memcpy(master->request, plain, bytes);
        master->request_bytes = bytes;
    }
    master->state = ASKING;
    master->has_cookie = 0;
    master->began_ns = now;
}

void master_ask(struct master *master, uint64_t now)
{
    static const uint8_t zeros[LEAST_HELLO];
    if (master->state == ABSENT || (double)(now - master->began_ns) > LONGEST_ATTEMPT_NS)
        begin(master, now);
    uint8_t body[LEAST_HELLO + MOST_BYTES];
    struct writer to = {body};
    put_byte(&to, 0x95);
    put_uint(&to, master->nonce);
    put_bin(&to, master->cookie, master->has_cookie ? COOKIE_BYTES : 0);
    put_bin(&to, master->request, master->request_bytes);
    put_bin(&to, master->mac, wanted.sealed ? MAC_BYTES : 0);
    const size_t unpadded = (size_t)(to.at - body) + 2 + 8; /* the padding's head, and the frame's */
    put_bin(&to, zeros, unpadded < LEAST_HELLO ? LEAST_HELLO - unpadded : 0);
    struct writer out = {link_room(master->index)};
    uint8_t *const start = out.at;
    put_head(&out, wanted.sealed ? SEALED_VERSION : OPEN_VERSION, HELLO, 0, 0);
    put_bin(&out, body, (size_t)(to.at - body));
    link_written((size_t)(out.at - start));
    master->said_ns = now;
}

static void send_message(struct master *master, int kind, const uint8_t *body, size_t bytes)
{
    struct writer out = {link_room(master->index)};
    uint8_t *const start = out.at;
    const uint32_t sequence = master->sequence++;
    put_head(&out, wanted.sealed ? SEALED_VERSION : OPEN_VERSION, kind, master->session, sequence);
    const size_t head_bytes = (size_t)(out.at - start);
    if (wanted.sealed) {
        uint8_t sealed[128];
        memcpy(sealed, body, bytes);
        seal_close(&master->seal, sequence, start, head_bytes, sealed, bytes);
        put_bin(&out, sealed, bytes + TAG_BYTES);
    } else {
        put_bin(&out, body, bytes);
    }
    counts.sent_bytes += (uint64_t)(out.at - start);
    link_written((size_t)(out.at - start));
}

void master_position(struct master *master, uint64_t now)
{
    uint8_t body[64], payload[6];
    struct writer to = {body};
    const double angle = TURN * (HAND_HZ * (double)now * 1e-9) + master->phase;
    store_single(payload, HAND_M * sin(angle));
    if (wanted.share > 0.0)
        store_half(payload + 4, TURN * HAND_HZ * HAND_M * cos(angle));
    put_byte(&to, 0x93);
    put_uint(&to, (uint32_t)(now / 1000));
    if (master->has_confirmed)
        put_uint(&to, master->confirmed);
    else
        put_byte(&to, 0xc0);
    put_bin(&to, payload, wanted.share > 0.0 ? 6 : 4);
    if (wanted.sealed && master->sequence >= SEAL_EPOCH) {
        master->state = CLOSED;
        counts.ended++;
        return;
    }
    send_message(master, POSITION, body, (size_t)(to.at - body));
    counts.positions++;
}

void master_close(struct master *master)
{
    uint8_t body[16];
    struct writer to = {body};
    put_byte(&to, 0x92);
    put_text(&to, "done");
    put_uint(&to, 0);
    send_message(master, CLOSE, body, (size_t)(to.at - body));
    master->state = CLOSING;
}

static int take_cookie(struct master *master, const struct frame *frame, uint64_t now)
{
    struct reader from = {frame->body, frame->body + frame->body_bytes};
    const uint8_t *cookie;
    size_t bytes;
    uint64_t nonce;
    if (get_array(&from, 2) || get_uint(&from, &nonce) || get_bytes(&from, &cookie, &bytes) || bytes != COOKIE_BYTES)
        return -1;
    if (master->state != ASKING || nonce != master->nonce)
        return 0;
    memcpy(master->cookie, cookie, bytes);
    if (!master->has_cookie) {
        master->has_cookie = 1;
        master_ask(master, now);
    }
    return 0;
}

static int take_welcome(struct master *master, const struct frame *frame, uint64_t now)
{
    struct reader from = {frame->body, frame->body + frame->body_bytes};
    uint8_t plain[MOST_BYTES];
    const uint8_t *grant, *scene, *ticket;
    size_t bytes, scene_bytes, ticket_bytes;
    uint64_t nonce, session, keepalive_us;
    double rate_hz, share;
    int resumed, announced;
    if (get_array(&from, 2) || get_uint(&from, &nonce) || get_bytes(&from, &grant, &bytes))
        return -1;
    if (master->state != ASKING || nonce != master->nonce)
        return 0;
    if (wanted.sealed) {
        if (noise_read(&master->noise, grant, bytes, plain, &master->seal))
            return -1;
        grant = plain;
        bytes -= NOISE2_MORE;
    }
    from = (struct reader){grant, grant + bytes};
    if (get_array(&from, 3) || get_uint(&from, &session))
        return -1;
    if (!session) { /* a sealed refusal */
        counts.refused++;
        master->state = CLOSED;
        return 0;
    }
    if (get_number(&from, &rate_hz) || get_uint(&from, &keepalive_us) || get_bytes(&from, &scene, &scene_bytes)
        || get_bytes(&from, &ticket, &ticket_bytes) || get_bool(&from, &resumed) || get_bool(&from, &announced)
        || get_number(&from, &share))
        return -1;
    if (announced || rate_hz < wanted.rate_hz || fabs(share - wanted.share) > 1e-6) { /* not the load that was asked for */
        counts.refused++;
        master->state = CLOSED;
        return 0;
    }
    master->session = (uint32_t)session;
    master->sequence = 1;
    master->newest = wanted.sealed ? 0 : frame->sequence;
    master->state = ESTABLISHED;
    master_position(master, now);
    return 0;
}

static int newer(uint32_t one, uint32_t other)
{
    return one != other && one - other < 1u << 31;
}

static void answered(uint32_t t_us, uint64_t now)
{
    if (t_us - counted_from_us >= 1u << 31)
        return;
    const uint32_t trip_us = (uint32_t)(now / 1000) - t_us;
    counts.answers++;
    counts.trips[trip_us < TRIP_BINS ? trip_us : trip_us < 1u << 31 ? TRIP_BINS - 1 : 0]++;
}

static int take_force(struct master *master, const struct frame *frame, struct reader *from, uint64_t now)
{
    uint64_t t_us;
    const uint8_t *payload;
    size_t bytes;
    if (get_array(from, 2) || get_uint(from, &t_us) || get_bytes(from, &payload, &bytes) || (bytes != 4 && bytes != 8))
        return -1;
    const double force_n = bytes == 4 ? load_single(payload) : load_double(payload);
    if (!(fabs(force_n) <= LARGEST_N)) /* false for NaN, too */
        return -1;
    if (fabs(force_n) > counts.greatest_n)
        counts.greatest_n = fabs(force_n);
    counts.forces++;
    answered((uint32_t)t_us, now);
    const uint32_t age_us = (uint32_t)(now / 1000) - (uint32_t)t_us;
    if (age_us > LATEST_ANSWER_US && age_us < 1u << 31)
        return 0;
    if (!master->has_force || newer(frame->sequence, master->newest_force)) {
        master->newest_force = master->confirmed = frame->sequence;
        master->has_force = master->has_confirmed = 1;
    }
    return 0;
}

static int take_keepalive(struct master *master, const struct frame *frame, struct reader *from, uint64_t now, int is_newest)
{
    uint64_t t_us, force;
    int none;
    if (get_array(from, 2) || get_uint(from, &t_us) || get_uint_or_nil(from, &force, &none))
        return -1;
    counts.keepalives++;
    answered((uint32_t)t_us, now);
    if (is_newest && !none && master->has_force && !newer((uint32_t)force, master->newest_force)) {
        master->confirmed = frame->sequence;
        master->has_confirmed = 1;
    }
    return 0;
}

static int take_message(struct master *master, uint8_t *data, const struct frame *frame, uint64_t now)
{
    size_t bytes = frame->body_bytes;
    if (frame->session != master->session || (master->state != ESTABLISHED && master->state != CLOSING))
        return 0;
    if (wanted.sealed) {
        if (seal_open(&master->seal, frame->sequence, data, frame->head_bytes, data + (frame->body - data), bytes))
            return -1;
        bytes -= TAG_BYTES;
    }
    const int is_newest = newer(frame->sequence, master->newest);
    if (is_newest) {
        counts.lost += frame->sequence - master->newest - 1;
        master->newest = frame->sequence;
    } else {
        counts.late++;
        counts.lost -= counts.lost > 0;
    }
    struct reader from = {frame->body, frame->body + bytes};
    if (frame->kind == FORCE)
        return take_force(master, frame, &from, now);
    if (frame->kind == KEEPALIVE)
        return take_keepalive(master, frame, &from, now, is_newest);
    if (frame->kind != CLOSE)
        return -1;
    if (master->state == CLOSING)
        counts.closed++;
    else
        counts.ended++;
    master->state = CLOSED;
    return 0;
}

static int take_echo(const struct frame *frame, uint64_t now)
{
    struct reader from = {frame->body, frame->body + frame->body_bytes};
    uint64_t t_us;
    if (get_array(&from, 3) || get_uint(&from, &t_us))
        return -1;
    answered((uint32_t)t_us, now);
    return 0;
}

void master_take(struct master *master, uint8_t *data, size_t bytes, uint64_t now)
{
    struct frame frame;
    int bad = read_frame(data, bytes, &frame);
    counts.received++;
    counts.received_bytes += bytes;
    if (!bad)
        switch (frame.kind) {
        case COOKIE: bad = take_cookie(master, &frame, now); break;
        case WELCOME: bad = take_welcome(master, &frame, now); break;
        case REFUSE: /* proves nothing in a sealed session; the attempt is repeated */
            if (!wanted.sealed && master->state == ASKING) {
                counts.refused++;
                master->state = CLOSED;
            }
            break;
        case RESET: /* proves nothing in a sealed session, either */
            counts.resets++;
            if (!wanted.sealed && master->state == ESTABLISHED && frame.session == master->session) {
                counts.ended++;
                master->state = CLOSED;
            }
            break;
        case POSITION: bad = wanted.echoed ? take_echo(&frame, now) : -1; break;
        default: bad = take_message(master, data, &frame, now);
        }
    counts.malformed += bad != 0;
}
