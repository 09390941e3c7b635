#include "receiving.h"

#include "arrivals.h"
#include "asking.h"
#include "decoder.h"
#include "hold.h"

/* Whether answers are fresh, and the link alive */

int64_t hn_silent_us(hn_master *m, int64_t now_us)
{
    if (now_us < m->heard_us) /* a clock that went back must not shorten a silence */
        m->heard_us = now_us;
    return now_us - m->heard_us;
}

/* Return whether to ask for a new session while the present one continues. */
bool hn_needs_another(hn_master *m, int64_t now_us)
{
    int64_t too_old_us = now_us - m->too_old_us, quiet_us = hn_silent_us(m, now_us);
    int64_t keepalives = !m->now->sparse ? 1 : m->idle ? HN_IDLE_KEEPALIVES : HN_SPARSE_KEEPALIVES;
    if (m->doubted && quiet_us > keepalives * m->keepalive_us + HN_DOUBT_MARGIN_US)
        return true;
    /* A link that is too slow for this session would be too slow for another. */
    bool is_slow = m->too_old && 0 <= too_old_us && too_old_us <= HN_ASK_AGAIN_US;
    if (m->state == HN_STALE && now_us - m->stale_us > HN_ASK_AGAIN_US && !is_slow)
        return true;
    return m->sealing != NULL && m->now->sequence > HN_LAST_SEQUENCE - HN_RECENT; /* its numbers run out */
}

static void stop_asking_if_content(hn_master *m, int64_t now_us)
{
    if (m->asking && !hn_needs_another(m, now_us))
        hn_stop_asking(m);
}

/* Return whether an answer is fresh, and count it if not: its position was sent, and is not too old. With few
 * positions it may be for a later time, and its position older. */
static bool is_fresh(hn_master *m, uint32_t echoed_t_us, hn_arrival arrival, int64_t now_us, int64_t *t_us)
{
    *t_us = hn_unwrap(echoed_t_us, now_us);
    bool sent = *t_us <= m->newest_t_us || (*t_us <= m->newest_t_us + m->ahead_us && *t_us <= now_us);
    if (sent && now_us - *t_us <= HN_MAX_AGE_US - m->ahead_us)
        return true;
    m->counts.too_old++;
    if (sent && arrival == HN_NEW) {
        m->too_old = true;
        m->too_old_us = now_us;
    }
    if (m->state == HN_STALE && m->too_old)
        stop_asking_if_content(m, now_us);
    return false;
}

/* Note a fresh answer; only one newer than all before shows that the link is alive. */
static void hear(hn_master *m, hn_arrival arrival, int64_t now_us)
{
    if (arrival != HN_NEW)
        return;
    m->heard_us = now_us;
    m->too_old = m->doubted = false;
    if (m->state == HN_STALE)
        m->state = HN_ESTABLISHED;
    stop_asking_if_content(m, now_us);
}

/* Forces */

static hn_arrival arrive(hn_stream *s, uint32_t sequence)
{
    hn_arrival arrival = hn_arrive(&s->arrivals, sequence);
    if (arrival == HN_NEW || arrival == HN_LATE)
        hn_loss_arrived(&s->loss, sequence, arrival == HN_NEW);
    return arrival;
}

/* Return the time of the newest position whose answer may have arrived; the next answer comes within this period. */
int64_t hn_felt_time(const hn_master *m, const hn_stream *s, int64_t now_us)
{
    int64_t late_us = now_us - s->felt_us - m->position_period_us;
    if (!s->felt)
        return now_us;
    return s->felt_t_us + (late_us > 0 ? late_us : 0);
}

void hn_reconstruct(hn_master *m, hn_stream *s, int64_t t_us, double stimulus_n[])
{
    if (m->request.more != NULL)
        m->request.more->ops->reconstruct(m, s, t_us, stimulus_n);
    else
        hn_decoder_apply(&s->decoder, t_us, stimulus_n);
}

/* Name a datagram in the positions to come; if they are few, send one soon. */
static void acknowledge(hn_stream *s, uint32_t sequence, bool soon, int64_t now_us)
{
    s->confirmed = (hn_maybe){true, sequence};
    s->confirmed_us = now_us;
    if (soon && !s->owes) {
        s->owes = true;
        s->owes_us = now_us;
    }
}

/* Apply a force that was decoded. */
void hn_apply(hn_master *m, hn_stream *s, uint32_t sequence, int64_t t_us, int64_t now_us)
{
    hn_vector stimulus_n;
    s->felt = true;
    s->felt_t_us = t_us;
    s->felt_us = now_us;
    if (s == m->now && s != m->felt) {
        hn_hold_restart(&m->hold);
        m->felt = s; /* and the rest of the old session is dropped */
    }
    if (s == m->now) {
        s->newest_force = (hn_maybe){true, sequence};
        acknowledge(s, sequence, true, m->heard_us);
    }
    hn_reconstruct(m, s, t_us, stimulus_n);
    hn_hold_receive(&m->hold, stimulus_n, now_us);
}

static void decode(hn_master *m, hn_stream *s, uint32_t sequence, int64_t t_us, hn_bytes payload, int64_t now_us)
{
    const struct hn_more *more = m->request.more;
    hn_outcome outcome = more != NULL                            ? more->ops->decode(m, s, sequence, t_us, payload)
                         : hn_decode(&s->decoder, t_us, payload) ? HN_APPLIED
                                                                 : HN_REFUSED;
    if (outcome == HN_REFUSED)
        m->counts.malformed++; /* not acknowledged, so that the slave repairs it */
    else if (outcome == HN_APPLIED)
        hn_apply(m, s, sequence, t_us, now_us);
}

static void receive_bound(hn_master *m, const hn_stream *s, hn_bytes bound)
{
    if (s->sparse && bound.at != NULL && !m->request.more->ops->bound(m, bound))
        m->counts.malformed++;
}

static void receive_force(hn_master *m, hn_stream *s, const hn_frame *frame, int64_t now_us)
{
    hn_force force;
    int64_t t_us;
    if (!hn_read_force(frame->body, &force)) {
        m->counts.malformed++;
        return;
    }
    hn_arrival arrival = arrive(s, frame->sequence);
    bool is_parting = s != m->now;
    if (is_parting && arrival != HN_NEW)
        return;
    bool fresh = is_fresh(m, force.t_us, arrival, now_us, &t_us);
    bool overtaken = arrival == HN_LATE && s->newest_force.is_set &&
                     hn_distance(frame->sequence, s->newest_force.value) <= 0;
    if (!fresh || overtaken || arrival == HN_ASTRAY || arrival == HN_DUPLICATE) {
        m->counts.stray += arrival == HN_ASTRAY;
        return;
    }
    hear(m, arrival, now_us);
    if (is_parting)
        s->newest_force = (hn_maybe){true, frame->sequence};
    else if (arrival == HN_NEW)
        receive_bound(m, s, force.bound);
    decode(m, s, frame->sequence, t_us, force.payload, now_us);
}

/* Return whether a KEEPALIVE that names a FORCE confirms the one applied: that FORCE, or a later one. */
static bool confirms(const hn_stream *s, hn_maybe named)
{
    if (!named.is_set || !s->newest_force.is_set)
        return named.is_set == s->newest_force.is_set;
    return hn_distance(s->newest_force.value, named.value) >= 0;
}

static void receive_keepalive(hn_master *m, hn_stream *s, const hn_frame *frame, int64_t now_us)
{
    hn_keepalive keepalive;
    int64_t t_us;
    if (!hn_read_keepalive(frame->body, &keepalive)) {
        m->counts.malformed++;
        return;
    }
    hn_arrival arrival = arrive(s, frame->sequence);
    if (s != m->now && arrival != HN_NEW)
        return;
    m->counts.stray += arrival == HN_ASTRAY;
    if (!is_fresh(m, keepalive.t_us, arrival, now_us, &t_us) || arrival != HN_NEW)
        return;
    hear(m, arrival, now_us);
    if (s == m->now)
        receive_bound(m, s, keepalive.bound);
    if (!confirms(s, keepalive.newest_force))
        return;
    if (s == m->now) { /* the slave waits for an answer to a bound, and while there is loss */
        uint32_t share, again;
        bool soon = keepalive.bound.at != NULL || hn_loss_estimate(&s->loss, &share, &again);
        acknowledge(s, frame->sequence, soon, now_us);
    }
    if (s == m->felt && s->felt) /* a new session does not confirm the force of an earlier one */
        hn_hold_confirm(&m->hold, now_us);
}

static void receive_close(hn_master *m, const hn_frame *frame)
{
    hn_ending close;
    if (!hn_read_ending(frame->body, HN_CLOSE, &close)) {
        m->counts.malformed++;
        return;
    }
    hn_arrival arrival = hn_arrive(&m->now->arrivals, frame->sequence);
    m->counts.stray += arrival == HN_ASTRAY;
    if (arrival != HN_NEW)
        return;
    if (m->state != HN_CLOSING)
        hn_note_reason(m, &close);
    if (m->state == HN_CLOSING || close.code == HN_CODE_FAILED) {
        hn_end(m);
        return;
    }
    m->state = HN_CONNECTING;
    m->streams[0].answers = m->streams[1].answers = false;
    hn_ask(m);
}

static void receive_notice(hn_master *m, const hn_frame *frame)
{
    hn_ending notice;
    if (!hn_read_ending(frame->body, HN_NOTICE, &notice)) {
        m->counts.malformed++;
        return;
    }
    hn_arrival arrival = arrive(m->now, frame->sequence);
    m->counts.stray += arrival == HN_ASTRAY;
    if ((arrival == HN_NEW || arrival == HN_LATE) && !notice.has_shapes)
        hn_note_reason(m, &notice);
}

static void receive_reset(hn_master *m, const hn_frame *frame)
{
    int64_t back = hn_distance(m->now->sequence, frame->sequence);
    if (back <= 0 || back > HN_RECENT)
        m->counts.stray++; /* it answers nothing that was sent lately */
    else if (m->state == HN_CLOSING)
        hn_end(m);
    else
        m->doubted = true;
}

static void receive_data(hn_master *m, hn_bytes datagram, hn_frame *frame, int64_t now_us)
{
    uint8_t plain[HN_DATAGRAM_BYTES];
    hn_stream *s = m->now->answers && frame->session == m->now->number     ? m->now
                   : m->felt->answers && frame->session == m->felt->number ? m->felt
                                                                           : NULL;
    bool is_answer = frame->kind == HN_FORCE || frame->kind == HN_KEEPALIVE;
    bool is_ours = s != NULL && (is_answer || (s == m->now && (frame->kind == HN_CLOSE || frame->kind == HN_NOTICE)));
    if (is_ours && m->sealing != NULL) {
        if (!m->sealing->open(m->keys, hn_stream_index(m, s), datagram.at, datagram.size, frame->sequence,
                              frame->body.size, plain)) {
            m->counts.malformed++;
            return;
        }
        frame->body = (hn_bytes){plain, frame->body.size - HN_TAG_BYTES};
    }
    if (is_ours && frame->kind == HN_FORCE)
        receive_force(m, s, frame, now_us);
    else if (is_ours && frame->kind == HN_KEEPALIVE)
        receive_keepalive(m, s, frame, now_us);
    else if (is_ours && frame->kind == HN_CLOSE)
        receive_close(m, frame);
    else if (is_ours)
        receive_notice(m, frame);
    else if (s == m->now && frame->kind == HN_RESET)
        receive_reset(m, frame);
    else
        m->counts.stray++;
}

void hn_master_receive(hn_master *m, const void *datagram, size_t size, int64_t now_us)
{
    hn_bytes data = {datagram, size};
    hn_frame frame;
    if (!hn_read_frame(data, &frame))
        m->counts.malformed++;
    else if (m->state == HN_CLOSED)
        m->counts.stray++;
    else if (frame.kind == HN_COOKIE)
        hn_receive_cookie(m, &frame, now_us);
    else if (frame.kind == HN_WELCOME)
        hn_receive_welcome(m, &frame, now_us);
    else if (frame.kind == HN_REFUSE)
        hn_receive_refuse(m, &frame, now_us);
    else if (frame.version == hn_version(m))
        receive_data(m, data, &frame, now_us);
    else
        m->counts.stray++;
}
