/* The master: docs/refer/protocol.md, "What the master does". */
#include <math.h>
#include <string.h>

#include "arrivals.h"
#include "asking.h"
#include "decoder.h"
#include "hold.h"
#include "more.h"

static bool is_streaming(const hn_master *m)
{
    return m->state == HN_ESTABLISHED || m->state == HN_STALE;
}

/* Whether answers are fresh, and the link alive */

static int64_t silent_us(hn_master *m, int64_t now_us)
{
    if (now_us < m->heard_us) /* a clock that went back must not shorten a silence */
        m->heard_us = now_us;
    return now_us - m->heard_us;
}

/* Return whether to ask for a new session while the present one continues. */
static bool needs_another(hn_master *m, int64_t now_us)
{
    int64_t too_old_us = now_us - m->too_old_us, quiet_us = silent_us(m, now_us);
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
    if (m->asking && !needs_another(m, now_us))
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

static void go_stale(hn_master *m, int64_t now_us)
{
    m->state = HN_STALE;
    m->stale_us = m->pace_us = now_us;
    m->pace_interval_us = 1000.0;
}

/* Return whether a position is due while the link is stale, and count it as sent. */
static bool is_due_when_stale(hn_master *m, int64_t now_us)
{
    if (0 < m->pace_us - now_us && m->pace_us - now_us <= HN_STALE_INTERVAL_US)
        return false;
    m->pace_interval_us = fmin(HN_STALE_GROWTH * m->pace_interval_us, HN_STALE_INTERVAL_US);
    m->pace_us = now_us + (int64_t)rint(m->pace_interval_us);
    return true;
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

static void reconstruct(hn_master *m, hn_stream *s, int64_t t_us, double stimulus_n[])
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
static void apply(hn_master *m, hn_stream *s, uint32_t sequence, int64_t t_us, int64_t now_us)
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
    reconstruct(m, s, t_us, stimulus_n);
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
        apply(m, s, sequence, t_us, now_us);
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

/* Each period */

static void repeat_close(hn_master *m, int64_t now_us)
{
    int64_t left_us = m->close_us - now_us;
    if (m->close_timed && 0 < left_us && left_us <= HN_CLOSE_INTERVAL_US)
        return;
    m->close_timed = true;
    m->close_us = now_us + HN_CLOSE_INTERVAL_US;
    if (m->closes_left == 0) {
        hn_end(m);
        return;
    }
    m->closes_left--;
    m->close_due = true;
}

/* Return whether this tick is the one nearest to the time at which the next position is due. */
static bool is_position_due(hn_master *m, int64_t now_us)
{
    int64_t period_us = (int64_t)rint(1e6 / m->request.rate_hz), wait_us = m->position_due_us - now_us;
    if (m->position_period_us <= period_us)
        return true;
    if (2 * wait_us > period_us && wait_us <= m->position_period_us)
        return false;
    /* After missed ticks or a clock that jumped, the positions continue from now. */
    bool kept = -m->position_period_us <= wait_us && wait_us <= m->position_period_us;
    m->position_due_us = (kept ? m->position_due_us : now_us) + m->position_period_us;
    return true;
}

/* Move the models of the contact ahead, and apply the forces of those that have caught up. */
static void move_models(hn_master *m, int64_t now_us)
{
    hn_stream *streams[] = {m->felt, m->now};
    hn_late late;
    m->request.more->ops->move(m, now_us);
    for (unsigned i = 0; i < 2; i++)
        if ((i == 0 || streams[0] != streams[1]) && m->request.more->ops->caught_up(m, streams[i], &late))
            apply(m, streams[i], late.sequence, late.t_us, now_us);
}

/* Prepare the position of a tick, if it is to be sent. */
static void take_position(hn_master *m, int64_t now_us)
{
    const hn_stream *s = m->now;
    const struct hn_more *more = m->request.more;
    int state = more != NULL ? more->ops->model_state(m, s) : -1;
    unsigned first = state >= 0, axes = m->request.axes;
    m->payload[0] = (uint8_t)state;
    m->payload_size = first + 4 * axes;
    for (unsigned i = 0; i < axes && !s->sparse; i++)
        hn_store_single(m->payload + first + 4 * i, m->position_m[i]);
    if (s->sparse) {
        int64_t owed_us = now_us - s->owes_us; /* below 0: the clock went back */
        bool wanted = m->state == HN_STALE || (s->owes && (owed_us < 0 || owed_us >= HN_ACK_DELAY_US));
        size_t size = more->ops->promise(m, now_us, wanted, m->payload + first);
        m->payload_size = size > 0 ? first + size : 0;
    }
    if (m->payload_size > 0 && (m->state == HN_ESTABLISHED || is_due_when_stale(m, now_us))) {
        m->position_due = true;
        m->newest_t_us = now_us;
    }
    if (s->sparse)
        more->ops->follow(m, now_us, m->payload_size == 0 || m->position_due);
}

void hn_master_tick(hn_master *m, const double position_m[], int64_t now_us)
{
    if (m->state == HN_CLOSING)
        repeat_close(m, now_us);
    else if (m->state == HN_ESTABLISHED && silent_us(m, now_us) > (m->idle ? HN_IDLE_STALE_US : HN_STALE_AFTER_US))
        go_stale(m, now_us);
    if (is_streaming(m) && needs_another(m, now_us))
        hn_ask(m);
    hn_tick_asking(m, now_us);
    m->position_due = false;
    if (!is_streaming(m) || position_m == NULL || !hn_in_range(position_m, m->request.axes))
        return;
    memcpy(m->position_m, position_m, m->request.axes * sizeof *position_m);
    m->has_position = true;
    m->position_us = now_us;
    if (m->request.more != NULL)
        move_models(m, now_us);
    if (is_position_due(m, now_us))
        take_position(m, now_us);
}

/* Whether next to no force is applied, so that silence does no harm. */
static bool is_idle(hn_master *m)
{
    return m->now->sparse && hn_norm(m->hold.stimulus_n, m->request.axes) < m->idle_below_n &&
           !hn_needs_position(m->felt->decoder.settings.codec) && !m->request.more->ops->on_model(m, m->felt);
}

void hn_master_force(hn_master *m, double force_n[], int64_t now_us)
{
    hn_stream *s = m->felt;
    if (m->request.more != NULL)
        m->request.more->ops->advance(m, now_us);
    if (s->felt) {
        hn_vector stimulus_n;
        reconstruct(m, s, hn_felt_time(m, s, now_us), stimulus_n);
        hn_hold_follow(&m->hold, stimulus_n, now_us);
    }
    m->idle = is_idle(m);
    m->hold.kept = m->idle && m->state == HN_ESTABLISHED && s->felt;
    hn_hold_value(&m->hold, force_n, now_us);
    for (unsigned i = 0; i < m->request.axes && m->state == HN_CLOSED; i++)
        force_n[i] = 0.0;
}

static size_t send_position(hn_master *m, uint8_t *data)
{
    hn_stream *s = m->now;
    hn_position position = {
        .t_us = (uint32_t)(uint64_t)m->position_us,
        .newest = s->confirmed,
        .payload = {m->payload, m->payload_size},
    };
    s->owes = false;
    if (++s->positions % HN_REPORT_EVERY == 0 || s->sparse)
        position.reports = hn_loss_estimate(&s->loss, &position.share, &position.again);
    if (s->sparse && m->position_us > s->confirmed_us) {
        int64_t waited_ms = (m->position_us - s->confirmed_us) / 1000;
        position.waited_ms = waited_ms < HN_MOST_WAITED_MS ? (uint32_t)waited_ms : HN_MOST_WAITED_MS;
    }
    return hn_write_position(data, s->number, s->sequence++, &position);
}

static size_t send_close(hn_master *m, uint8_t *data)
{
    hn_ending close = {.reason = hn_text(m->reason)};
    return hn_write_ending(data, HN_CLOSE, m->now->number, m->now->sequence++, &close);
}

size_t hn_master_send(hn_master *m, uint8_t datagram[HN_DATAGRAM_BYTES])
{
    bool close = m->close_due, position = m->position_due && is_streaming(m);
    if (m->hello_due) {
        m->hello_due = false;
        return hn_send_hello(m, datagram);
    }
    m->close_due = m->position_due = false;
    if (!(close || position) || (m->sealing != NULL && m->now->sequence > HN_LAST_SEQUENCE))
        return 0; /* a number must not repeat under one key */
    size_t size = close ? send_close(m, datagram) : send_position(m, datagram);
    return m->sealing == NULL ? size : m->sealing->seal(m->keys, hn_stream_index(m, m->now), datagram, size);
}

void hn_master_close(hn_master *m, const char *reason, int64_t now_us)
{
    if (m->state == HN_CLOSING || m->state == HN_CLOSED)
        return;
    hn_bytes text = hn_text(reason);
    if (!hn_is_text(text, HN_REASON_BYTES)) /* the slave would drop it */
        text.size = 0;
    hn_stop_asking(m);
    hn_copy_text(m->reason, sizeof m->reason, text);
    m->code = HN_CODE_OTHER;
    if (m->state == HN_CONNECTING) {
        hn_end(m);
        return;
    }
    m->state = HN_CLOSING;
    m->closes_left = HN_CLOSE_TRIES;
    repeat_close(m, now_us);
}

const char *hn_master_init(hn_master *m, const hn_request *request, hn_entropy *entropy, void *context)
{
    hn_settings settings;
    memset(m, 0, sizeof *m);
    m->request = *request;
    m->entropy = entropy;
    m->context = context;
    m->now = m->felt = m->streams;
    m->refused_wait_us = HN_REFUSED_RETRY_US;
    hn_hold_init(&m->hold, request->axes);
    hn_ask(m);
    return hn_take_settings(request, &settings);
}

hn_state hn_master_state(const hn_master *m)
{
    return m->state;
}

const char *hn_master_reason(const hn_master *m, unsigned *code)
{
    *code = m->code;
    return m->reason;
}

const char *hn_master_scene(const hn_master *m)
{
    return m->scene;
}

hn_counts hn_master_counts(const hn_master *m)
{
    return m->counts;
}
