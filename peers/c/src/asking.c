#include "asking.h"

#include <math.h>
#include <string.h>

#include "arrivals.h"
#include "decoder.h"
#include "hold.h"
#include "more.h"

uint32_t hn_version(const hn_master *m)
{
    return m->sealing != NULL ? 2 : 1;
}

/* Asking for a session */

void hn_ask(hn_master *m)
{
    if (m->asking)
        return;
    m->asking = true;
    m->tries = 0;
    m->hello_interval_us = HN_HELLO_INTERVAL_US;
}

/* A HELLO that is due is still sent: its sender may have received several datagrams before it sends. */
void hn_stop_asking(hn_master *m)
{
    m->asking = m->attempted = false;
}

static hn_bytes pack_request(const hn_master *m, uint8_t *packed, size_t size)
{
    hn_asked asked = {
        .codec = hn_text(m->request.codec),
        .weber_fraction = m->request.weber_fraction,
        .floor_n = m->request.floor_n,
        .multiplier = m->request.multiplier,
        .rate_hz = m->request.rate_hz,
        .axes = m->request.axes,
        .name = hn_text(m->request.name),
        .ticket = {m->had_session ? m->ticket : NULL, HN_TICKET_BYTES},
        .clock_us = (uint64_t)m->clock_us,
        .announced = m->request.announced,
        .position_share = m->request.position_share,
        .predicted = m->request.predicted,
    };
    for (; asked.count < HN_MOST_PARAMETERS && m->request.parameters[asked.count].name != NULL; asked.count++) {
        const hn_parameter *parameter = &m->request.parameters[asked.count];
        asked.parameters[asked.count] = (hn_named){hn_text(parameter->name), parameter->value};
    }
    return hn_pack_asked(packed, size, &asked);
}

static void begin_attempt(hn_master *m, int64_t now_us)
{
    uint8_t packed[HN_DATAGRAM_BYTES];
    m->attempted = true;
    m->has_cookie = m->hinted = false;
    m->nonce = m->entropy(m->context);
    m->clock_us = now_us;
    if (m->tries == 0)
        m->hello_interval_us = HN_HELLO_INTERVAL_US;
    if (m->sealing != NULL) {
        hn_bytes request = pack_request(m, packed, sizeof packed);
        m->sealing->ask(m, request.at, request.size);
    }
}

void hn_tick_asking(hn_master *m, int64_t now_us)
{
    int64_t waited_us = now_us - m->tried_us; /* below 0: the clock went back */
    if (!m->asking || (m->tried && 0 <= waited_us && waited_us < m->hello_interval_us))
        return;
    if (!m->attempted || (m->has_cookie && now_us - m->cookie_us > HN_NEW_ATTEMPT_US))
        begin_attempt(m, now_us);
    if (++m->tries > HN_QUICK_HELLOS)
        m->hello_interval_us = (int64_t)fmin(rint((double)m->hello_interval_us * HN_HELLO_GROWTH), HN_SLOWEST_HELLO_US);
    m->tried = m->hello_due = true;
    m->tried_us = now_us;
}

/* Return whether a request has the memory that it needs: of none other, whose parts may be fewer or shorter. */
static bool request_has_memory(const hn_request *request)
{
    bool follows = hn_needs_position(hn_codec_named(hn_text(request->codec)));
    bool sparse = request->position_share != 0.0;
    const struct hn_more *more = request->more;
    if (more == NULL)
        return !(follows || request->announced || sparse);
    return more->axes == request->axes && more->rate_hz == request->rate_hz && more->follows == follows &&
           more->announced == request->announced && more->sparse == sparse;
}

/* Take the settings of a request; return NULL or what is wrong with it. */
const char *hn_take_settings(const hn_request *request, hn_settings *s)
{
    *s = (hn_settings){
        .codec = request->codec == NULL ? HN_CODEC_UNKNOWN : hn_codec_named(hn_text(request->codec)),
        .axes = request->axes,
        .weber_fraction = request->weber_fraction,
        .floor_n = request->floor_n,
        .multiplier = request->multiplier,
    };
    if (s->codec == HN_CODEC_UNKNOWN)
        return HN_WRONG_CODEC;
    hn_set_defaults(s);
    const char *wrong = NULL;
    for (unsigned i = 0; i < HN_MOST_PARAMETERS && request->parameters[i].name != NULL && wrong == NULL; i++)
        wrong = hn_set(s, hn_text(request->parameters[i].name), request->parameters[i].value);
    if (wrong == NULL)
        wrong = hn_law_wrong(s);
    if (wrong != NULL)
        return wrong;
    if (s->axes < 1 || s->axes > HN_MOST_AXES)
        return HN_WRONG_AXES;
    if (!(HN_LEAST_RATE_HZ <= request->rate_hz && request->rate_hz <= HN_MOST_RATE_HZ))
        return HN_WRONG_RATE_HZ;
    if (request->position_share != 0.0 &&
        !(HN_LEAST_SHARE <= request->position_share && request->position_share <= HN_MOST_SHARE))
        return HN_WRONG_POSITION_SHARE;
    if (request->name == NULL || !hn_is_text(hn_text(request->name), HN_NAME_BYTES))
        return HN_WRONG_NAME;
    if (!request_has_memory(request))
        return "more must be what hn_more_init makes of this request";
    return NULL;
}

size_t hn_send_hello(const hn_master *m, uint8_t *data)
{
    uint8_t packed[HN_DATAGRAM_BYTES];
    hn_hello hello = {.nonce = m->nonce, .cookie = {m->cookie, m->has_cookie ? HN_COOKIE_BYTES : 0}};
    if (m->sealing == NULL) {
        hello.request = pack_request(m, packed, sizeof packed);
        return hn_write_hello(data, 0, &hello);
    }
    hello.mac.size = 16;
    m->sealing->hello(m->keys, &hello.request.at, &hello.request.size, &hello.mac.at);
    size_t size = hn_write_hello(data, 0, &hello);
    data[1] = 2;
    return size;
}

/* Sessions */

enum { AHEAD_US = 3 * HN_LONGEST_SILENCE_US / 2 }; /* how long after a position the slave may answer along its line */

void hn_end(hn_master *m)
{
    hn_stop_asking(m);
    m->hello_due = false;
    m->state = HN_CLOSED;
    hn_hold_release(&m->hold);
}

void hn_note_reason(hn_master *m, const hn_ending *ending)
{
    hn_copy_text(m->reason, sizeof m->reason, ending->reason);
    m->code = ending->code;
}

unsigned hn_stream_index(const hn_master *m, const hn_stream *s)
{
    return (unsigned)(s - m->streams);
}

/* Use a granted session. The force of the one before continues until the first of this one is applied. */
static void begin(hn_master *m, const hn_grant *grant, uint32_t sequence, int64_t now_us)
{
    hn_settings settings;
    hn_take_settings(&m->request, &settings);
    hn_stream *next = m->felt->felt ? &m->streams[m->felt == m->streams] : m->felt;
    memset(next, 0, sizeof *next);
    next->answers = true;
    next->number = grant->session;
    next->sequence = 1;
    hn_arrivals_init(&next->arrivals, sequence, m->sealing != NULL);
    hn_loss_init(&next->loss, sequence);
    next->sparse = grant->position_share > 0.0;
    next->predicted = grant->predicted;
    next->announced = grant->announced;
    m->ahead_us = next->sparse ? AHEAD_US : 0;
    m->idle_below_n = next->sparse ? HN_IDLE_SHARE * fmin(hn_threshold(&settings, 0.0), HN_IDLE_THRESHOLD_N) : 0.0;
    if (next->sparse && settings.multiplier > 0.0) /* positions use their share of the difference */
        settings.multiplier = fmax((1.0 - grant->position_share) * settings.multiplier, HN_LEAST_LAW);
    hn_decoder_init(&next->decoder, &settings);
    if (m->request.more != NULL)
        m->request.more->ops->begin(m, next, grant);
    m->now = next;
    if (m->sealing != NULL)
        m->sealing->use(m->keys, hn_stream_index(m, next));
    if (m->felt != next)
        m->felt->answers = m->felt->answers && m->felt->newest_force.is_set;

    hn_stop_asking(m);
    m->hello_due = false;
    m->refused_wait_us = HN_REFUSED_RETRY_US;
    m->state = HN_ESTABLISHED;
    m->had_session = true;
    memcpy(m->ticket, grant->ticket.at, sizeof m->ticket);
    hn_copy_text(m->scene, sizeof m->scene, grant->scene);
    m->keepalive_us = grant->keepalive_us;
    m->position_period_us = (int64_t)rint(1e6 / fmin(m->request.rate_hz, grant->rate_hz));
    m->heard_us = now_us;
    m->too_old = m->doubted = false;
}

void hn_receive_cookie(hn_master *m, const hn_frame *frame, int64_t now_us)
{
    hn_answer cookie;
    if (!hn_read_answer(frame->body, HN_COOKIE, &cookie)) {
        m->counts.malformed++;
    } else if (!m->attempted || cookie.nonce != m->nonce) {
        m->counts.stray++;
    } else {
        memcpy(m->cookie, cookie.bytes.at, sizeof m->cookie);
        if (m->has_cookie) { /* only the first cookie of an attempt is answered at once */
            m->counts.stray++;
            return;
        }
        m->has_cookie = m->hello_due = true;
        m->cookie_us = m->tried_us = now_us;
    }
}

static void refused(hn_master *m, const hn_ending *refusal, int64_t now_us)
{
    hn_note_reason(m, refusal);
    if (!m->had_session && refusal->code != HN_CODE_STOPPING) {
        hn_end(m);
        return;
    }
    m->attempted = m->hello_due = false; /* ask again, later after each refusal */
    m->hello_interval_us = m->refused_wait_us;
    m->refused_wait_us *= 2;
    if (m->refused_wait_us > HN_SLOWEST_RETRY_US)
        m->refused_wait_us = HN_SLOWEST_RETRY_US;
    m->tries = 0;
    m->tried = true;
    m->tried_us = now_us;
}

/* Return whether a grant has nothing that was not asked for; a slave may compute with float32. */
static bool was_asked_for(const hn_master *m, const hn_grant *grant)
{
    double share = grant->position_share, asked = m->request.position_share;
    return (!grant->announced || m->request.announced) && (!grant->predicted || m->request.predicted) &&
           !grant->vibrates && (share == 0.0 || fabs(share - asked) <= 1e-6 * fmax(share, asked));
}

/* Take in a grant or, from a sealed WELCOME, a refusal. */
static void receive_granted(hn_master *m, hn_bytes granted, uint32_t sequence, int64_t now_us)
{
    hn_grant grant;
    hn_ending refusal;
    if (m->sealing != NULL && hn_read_ending(granted, HN_REFUSE, &refusal) && refusal.nonce == 0)
        refused(m, &refusal, now_us);
    else if (!hn_read_grant(granted, &grant) || !was_asked_for(m, &grant))
        m->counts.malformed++;
    else
        begin(m, &grant, sequence, now_us);
}

void hn_receive_welcome(hn_master *m, const hn_frame *frame, int64_t now_us)
{
    uint8_t plain[HN_DATAGRAM_BYTES];
    hn_answer welcome;
    if (!hn_read_answer(frame->body, HN_WELCOME, &welcome)) {
        m->counts.malformed++;
    } else if (!m->attempted || welcome.nonce != m->nonce || frame->version != hn_version(m)) {
        m->counts.stray++;
    } else if (m->sealing == NULL) {
        receive_granted(m, welcome.bytes, frame->sequence, now_us);
    } else { /* nothing authenticates the sequence of a sealed WELCOME: it is taken as 0 */
        hn_bytes opened = {plain, m->sealing->answer(m->keys, welcome.bytes.at, welcome.bytes.size, plain)};
        receive_granted(m, opened, 0, now_us);
    }
}

void hn_receive_refuse(hn_master *m, const hn_frame *frame, int64_t now_us)
{
    hn_ending refusal;
    if (!hn_read_ending(frame->body, HN_REFUSE, &refusal)) {
        m->counts.malformed++;
    } else if (!m->attempted || refusal.nonce != m->nonce || m->hinted) {
        m->counts.stray++;
    } else if (m->sealing == NULL) {
        refused(m, &refusal, now_us);
    } else { /* not authentic, so only a hint */
        m->hinted = true;
        hn_note_reason(m, &refusal);
    }
}
