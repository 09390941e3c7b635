#include "more.h"

#include <math.h>
#include <string.h>

#include "asking.h"
#include "hold.h"
#include "values.h"

static hn_side *side_of(const hn_master *m, const hn_stream *s)
{
    return &m->request.more->sides[hn_stream_index(m, s)];
}

/* The decoder of a session, and the model that replaces it */

static bool decode_with(hn_announced *announced, hn_decoder *decoder, hn_past *past, int64_t t_us, hn_bytes payload)
{
    if (announced != NULL && (payload.size == 0 || payload.at[0] != 0))
        return hn_announced_decode(announced, t_us, payload);
    if (announced != NULL)
        payload = (hn_bytes){payload.at + 1, payload.size - 1};
    if (!hn_decode(decoder, t_us, payload))
        return false;
    if (past != NULL)
        hn_past_decode(past, t_us, payload);
    if (announced != NULL)
        hn_announced_end_model(announced);
    return true;
}

static hn_outcome decode(hn_master *m, hn_stream *s, uint32_t sequence, int64_t t_us, hn_bytes payload)
{
    hn_side *side = side_of(m, s);
    const hn_announced *a = side->uses.announced;
    if (side->lates > 0 && hn_distance(sequence, side->late[side->lates - 1].sequence) <= 0)
        return HN_LATER; /* the model that waits is newer */
    if (!decode_with(side->uses.announced, &s->decoder, side->uses.past, t_us, payload))
        return HN_REFUSED;
    if (side->uses.line != NULL) /* it refuses a model while it has no position */
        decode_with(side->uses.line_announced, side->uses.line, NULL, t_us, payload);
    if (a == NULL || a->settled == a->taken) {
        side->lates = 0;
        return HN_APPLIED;
    }
    /* Of the models that wait, only the newest counts. */
    side->late[side->lates > 0] = (hn_late){a->taken, sequence, t_us};
    side->lates += side->lates < 2;
    return HN_LATER;
}

static bool caught_up(hn_master *m, hn_stream *s, hn_late *late)
{
    hn_side *side = side_of(m, s);
    bool found = false;
    while (side->lates > 0 && side->late[0].number <= side->uses.announced->settled) {
        found = true;
        *late = side->late[0];
        side->late[0] = side->late[1];
        side->lates--;
    }
    return found;
}

static void move(hn_master *m, int64_t now_us)
{
    hn_announced *felt = side_of(m, m->felt)->uses.announced, *next = side_of(m, m->now)->uses.announced;
    if (felt != NULL)
        hn_announced_move(felt, now_us, m->position_m);
    if (next != NULL && next != felt)
        hn_announced_move(next, now_us, m->position_m);
}

static bool on_model(hn_master *m, const hn_stream *s)
{
    const hn_announced *a = side_of(m, s)->uses.announced;
    return a != NULL && a->on_model;
}

static int model_state(hn_master *m, const hn_stream *s)
{
    const hn_announced *a = side_of(m, s)->uses.announced;
    if (a == NULL)
        return -1;
    return a->on_model ? (int)hn_model_state(&a->model) : 0;
}

static void reconstruct(hn_master *m, hn_stream *s, int64_t t_us, double stimulus_n[])
{
    const struct hn_more *more = m->request.more;
    hn_side *side = side_of(m, s);
    if (on_model(m, s)) {
        hn_copy(stimulus_n, side->uses.announced->model.force_n, m->request.axes);
        return;
    }
    if (more->has_position)
        hn_decoder_move(&s->decoder, more->position_us, more->position_m);
    hn_decoder_apply(&s->decoder, t_us, stimulus_n);
    if (more->has_position && side->uses.past != NULL)
        hn_past_limit(side->uses.past, t_us, more->position_m, more->position_us, stimulus_n);
}

static void advance(hn_master *m, int64_t now_us)
{
    struct hn_more *more = m->request.more;
    hn_vector ignored;
    more->has_position = m->has_position;
    more->position_us = now_us;
    hn_copy(more->position_m, m->position_m, m->request.axes);
    if (!m->has_position)
        return;
    if (m->now != m->felt) /* it needs the motion when its first force arrives */
        reconstruct(m, m->now, now_us, ignored);
    if (!m->felt->felt)
        reconstruct(m, m->felt, now_us, ignored);
}

/* Few positions */

/* Give what a decoder, or a model in its place, applies at a position ahead. */
static void predict(const hn_announced *announced, const hn_decoder *decoder, int64_t t_us, const double position_m[],
                    int64_t position_us, double force_n[])
{
    if (announced != NULL && announced->on_model) {
        hn_model_predict(&announced->model, position_us, position_m, force_n);
        return;
    }
    hn_decoder ahead = *decoder;
    hn_decoder_move(&ahead, position_us, position_m);
    hn_decoder_apply(&ahead, t_us, force_n);
}

typedef struct {
    const hn_side *side;
    int64_t at_us, now_us;
    unsigned axes;
    hn_vector here_n;
} comparison;

static bool compare(void *context, const double place_m[], double differs_n[])
{
    const comparison *c = context;
    if (c->side == NULL)
        return false;
    predict(c->side->uses.line_announced, c->side->uses.line, c->at_us, place_m, c->now_us, differs_n);
    for (unsigned i = 0; i < c->axes; i++)
        differs_n[i] = c->here_n[i] - differs_n[i];
    return true;
}

static size_t promise(hn_master *m, int64_t now_us, bool wanted, uint8_t *payload)
{
    const hn_side *side = side_of(m, m->felt);
    comparison c = {NULL, hn_felt_time(m, m->felt, now_us), now_us, m->request.axes, {0}};
    if (side->uses.line != NULL) {
        c.side = side;
        predict(side->uses.announced, &m->felt->decoder, c.at_us, m->position_m, now_us, c.here_n);
    }
    return hn_sender_position(m->request.more->sender, now_us, m->position_m,
                              hn_norm(m->hold.stimulus_n, m->request.axes), wanted, compare, &c, payload);
}

static void follow_in(hn_master *m, const hn_stream *s, int64_t now_us, const double place_m[])
{
    const hn_side *side = side_of(m, s);
    if (side->uses.line == NULL)
        return;
    if (side->uses.line_announced != NULL)
        hn_announced_move(side->uses.line_announced, now_us, place_m);
    if (side->uses.line_announced == NULL || !side->uses.line_announced->on_model)
        hn_decoder_move(side->uses.line, now_us, place_m);
}

static void follow(hn_master *m, int64_t now_us, bool is_known)
{
    hn_sender *sender = m->request.more->sender;
    hn_vector place_m;
    if (!is_known)
        sender->has_line = false;
    if (!hn_sender_place(sender, now_us, place_m))
        return;
    follow_in(m, m->felt, now_us, place_m);
    if (m->now != m->felt)
        follow_in(m, m->now, now_us, place_m);
}

static bool receive_bound(hn_master *m, hn_bytes payload)
{
    hn_bound bound;
    bool has, good = hn_read_bound(payload, m->request.axes, &has, &bound);
    hn_sender_bound(m->request.more->sender, has, &bound);
    return good;
}

/* Sessions and memory */

static void begin(hn_master *m, hn_stream *s, const hn_grant *grant)
{
    hn_side *side = side_of(m, s);
    hn_parts *uses = &side->uses;
    bool sparse = grant->position_share > 0.0;
    side->lates = 0;
    *uses = side->owns;
    if (!grant->announced)
        uses->announced = uses->line_announced = NULL;
    if (!sparse)
        uses->line_announced = NULL;
    if (!sparse || !(grant->announced || hn_needs_position(s->decoder.settings.codec)))
        uses->line = NULL;
    if (uses->past != NULL) {
        /* Between lines the slave steps where the hand may not be: what it judges there is limited in any case. */
        int64_t free_us = grant->predicted && !sparse ? HN_LONGEST_AHEAD_US + (int64_t)rint(1e6 / grant->rate_hz) : -1;
        hn_past_begin(uses->past, &s->decoder.settings, free_us);
    }
    if (uses->line != NULL)
        hn_decoder_init(uses->line, &s->decoder.settings);
    if (uses->announced != NULL)
        hn_announced_begin(uses->announced, hn_stiffest(grant->rate_hz));
    if (uses->line_announced != NULL)
        hn_announced_begin(uses->line_announced, hn_stiffest(grant->rate_hz));
    if (sparse) {
        hn_settings law = s->decoder.settings;
        law.multiplier = m->request.multiplier;
        hn_sender_init(m->request.more->sender, &law, grant->position_share);
    }
}

static const hn_more_ops OPS = {begin,   decode,      reconstruct, advance, move,   caught_up,
                                model_state, on_model, promise,     follow,  receive_bound};

/* What a request needs of each. */
typedef struct {
    bool past, announced, line, sender;
} needs;

static needs needs_of(const hn_request *request)
{
    bool good = 1 <= request->axes && request->axes <= HN_MOST_AXES && HN_LEAST_RATE_HZ <= request->rate_hz &&
                request->rate_hz <= HN_MOST_RATE_HZ;
    if (!good) /* hn_master_init will say so */
        return (needs){false, false, false, false};
    bool follows = request->codec != NULL && hn_needs_position(hn_codec_named(hn_text(request->codec)));
    bool sparse = request->position_share != 0.0;
    return (needs){follows, request->announced, sparse && (follows || request->announced), sparse};
}

/* Take a piece of the memory; with no memory, add up only. */
static void *take(uint8_t **memory, size_t size)
{
    uint8_t *taken = *memory;
    *memory += (size + 7) / 8 * 8;
    return taken;
}

size_t hn_more_bytes(const hn_request *request)
{
    needs n = needs_of(request);
    size_t each = 0, all = n.sender * (sizeof(hn_sender) + 8);
    if (!(n.past || n.announced || n.sender))
        return 0;
    if (n.past)
        each += sizeof(hn_past) + 8 + hn_past_bytes(request->axes, request->rate_hz);
    if (n.announced)
        each += (1u + n.line) * (sizeof(hn_announced) + 8 + hn_announced_bytes(request->axes));
    if (n.line)
        each += sizeof(hn_decoder) + 8;
    return sizeof(struct hn_more) + 8 + all + 2 * each;
}

struct hn_more *hn_more_init(void *memory, const hn_request *request)
{
    needs n = needs_of(request);
    uint8_t *at = memory;
    /* A request that needs none, or has a rate or axes out of range, may come with memory of no bytes. */
    if (memory == NULL || hn_more_bytes(request) == 0 || (uintptr_t)memory % sizeof(double) != 0)
        return NULL;
    struct hn_more *more = take(&at, sizeof *more);
    memset(more, 0, sizeof *more);
    more->ops = &OPS;
    more->axes = request->axes;
    more->rate_hz = request->rate_hz;
    more->follows = n.past;
    more->announced = n.announced;
    more->sparse = n.sender;
    if (n.sender)
        more->sender = take(&at, sizeof *more->sender);
    for (hn_side *side = more->sides; side < more->sides + 2; side++) {
        hn_parts *owns = &side->owns;
        if (n.past) {
            owns->past = take(&at, sizeof *owns->past);
            hn_past_init(owns->past, request->axes, request->rate_hz, &at);
        }
        if (n.line)
            owns->line = take(&at, sizeof *owns->line);
        if (n.announced) {
            owns->announced = take(&at, sizeof *owns->announced);
            hn_announced_init(owns->announced, request->axes, &more->allowance, &at);
        }
        if (n.announced && n.line) {
            owns->line_announced = take(&at, sizeof *owns->line_announced);
            hn_announced_init(owns->line_announced, request->axes, &more->allowance, &at);
        }
    }
    return more;
}
