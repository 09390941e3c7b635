/* The master in each period: docs/refer/protocol.md, "What the master does". What arrives is in receiving.c. */
#include <math.h>
#include <string.h>

#include "arrivals.h"
#include "asking.h"
#include "decoder.h"
#include "hold.h"
#include "receiving.h"

static bool is_streaming(const hn_master *m)
{
    return m->state == HN_ESTABLISHED || m->state == HN_STALE;
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
            hn_apply(m, streams[i], late.sequence, late.t_us, now_us);
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
    else if (m->state == HN_ESTABLISHED && hn_silent_us(m, now_us) > (m->idle ? HN_IDLE_STALE_US : HN_STALE_AFTER_US))
        go_stale(m, now_us);
    if (is_streaming(m) && hn_needs_another(m, now_us))
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
        hn_reconstruct(m, s, hn_felt_time(m, s, now_us), stimulus_n);
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
    hn_bytes text = hn_text(reason != NULL ? reason : "");
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
    const char *wrong = hn_take_settings(request, &settings);
    memset(m, 0, sizeof *m);
    m->entropy = entropy;
    m->context = context;
    m->now = m->felt = m->streams;
    m->refused_wait_us = HN_REFUSED_RETRY_US;
    if (wrong == NULL) {
        m->request = *request;
        hn_ask(m);
    } else { /* one that asks for nothing, whose force is zero */
        m->request.axes = request->axes < HN_MOST_AXES ? request->axes : HN_MOST_AXES;
        m->state = HN_CLOSED;
    }
    hn_hold_init(&m->hold, m->request.axes);
    return wrong;
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
