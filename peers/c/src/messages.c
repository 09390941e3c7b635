#include "messages.h"

#include <string.h>

#define OPEN_VERSION 1u
#define SEALED_VERSION 2u

bool hn_read_frame(hn_bytes data, hn_frame *frame)
{
    if (data.size > HN_DATAGRAM_BYTES)
        return false;
    hn_reader r = hn_read_from(data);
    if (hn_get_array(&r, 5) != 5)
        return false;
    uint64_t version = hn_get_uint(&r, UINT64_MAX);
    frame->version = version < UINT32_MAX ? (uint32_t)version : UINT32_MAX;
    frame->kind = hn_get_uint32(&r);
    frame->session = hn_get_uint32(&r);
    frame->sequence = hn_get_uint32(&r);
    frame->body = hn_get_bytes(&r);
    if (!hn_get_end(&r, 0) || frame->kind < HN_HELLO || frame->kind > HN_VIBRATION)
        return false;
    return frame->version == OPEN_VERSION || frame->version == SEALED_VERSION || frame->kind == HN_HELLO ||
           frame->kind == HN_REFUSE;
}

bool hn_read_nonce(hn_bytes body, uint32_t *nonce)
{
    hn_reader r = hn_read_from(body);
    unsigned elements = hn_get_array(&r, 1);
    *nonce = hn_get_uint32(&r);
    return hn_get_end(&r, elements - 1);
}

bool hn_read_hello(hn_bytes body, hn_hello *hello)
{
    hn_reader r = hn_read_from(body);
    unsigned elements = hn_get_array(&r, 5);
    hello->nonce = hn_get_uint32(&r);
    hello->cookie = hn_get_bytes(&r);
    hello->request = hn_get_bytes(&r);
    hello->mac = hn_get_bytes(&r);
    hn_get_bytes(&r); /* the padding */
    return hn_get_end(&r, elements - 5);
}

static unsigned get_parameters(hn_reader *r, hn_named *parameters)
{
    unsigned count = hn_get_map(r);
    for (unsigned i = 0; i < count && r->ok; i++) {
        parameters[i].name = hn_get_text(r, HN_NAME_BYTES);
        parameters[i].value = hn_get_number(r);
    }
    return count;
}

/* Read the name and the parameters of a coupling, or nil; return whether there is one. */
static bool get_coupling(hn_reader *r)
{
    hn_named ignored[HN_MOST_ELEMENTS];
    if (hn_get_nil(r))
        return false;
    if (hn_get_array(r, 2) != 2)
        r->ok = false;
    hn_get_text(r, HN_NAME_BYTES);
    get_parameters(r, ignored);
    return true;
}

static bool get_vibration(hn_reader *r, hn_asked *asked)
{
    if (hn_get_nil(r))
        return false;
    if (hn_get_array(r, 2) != 2)
        r->ok = false;
    asked->vibration_budget = hn_get_number(r);
    asked->vibration_threshold = hn_get_number(r);
    return true;
}

/* Read the parts of positions and forces, and their thresholds, or nil; return whether there are some. */
static bool get_parts(hn_reader *r)
{
    if (hn_get_nil(r))
        return false;
    if (hn_get_array(r, 2) != 2)
        r->ok = false;
    for (unsigned left = hn_get_array(r, 0); left > 0 && r->ok; left--)
        hn_get_text(r, HN_NAME_BYTES);
    for (unsigned left = hn_get_map(r); left > 0 && r->ok; left--) {
        hn_get_text(r, HN_NAME_BYTES);
        if (hn_get_array(r, 2) != 2)
            r->ok = false;
        hn_get_number(r);
        hn_get_number(r);
    }
    return true;
}

bool hn_read_asked(hn_bytes packed, hn_asked *asked)
{
    hn_reader r = hn_read_from(packed);
    unsigned elements = hn_get_array(&r, 12);
    memset(asked, 0, sizeof *asked);
    asked->codec = hn_get_text(&r, HN_NAME_BYTES);
    asked->count = get_parameters(&r, asked->parameters);
    asked->weber_fraction = hn_get_number(&r);
    asked->floor_n = hn_get_number(&r);
    asked->multiplier = hn_get_number(&r);
    asked->rate_hz = hn_get_number(&r);
    asked->axes = (unsigned)hn_get_uint(&r, HN_MOST_COMPONENTS);
    asked->name = hn_get_text(&r, HN_NAME_BYTES);
    if (!hn_get_nil(&r))
        asked->ticket = hn_get_bytes(&r);
    asked->clock_us = hn_get_uint(&r, HN_MOST_CLOCK_US);
    asked->announced = hn_get_bool(&r);
    asked->position_share = hn_get_number(&r);
    if (elements > 12)
        asked->predicted = hn_get_bool(&r);
    if (elements > 13)
        asked->coupled = get_coupling(&r);
    if (elements > 14)
        asked->vibrates = get_vibration(&r, asked);
    if (elements > 15)
        asked->has_parts = get_parts(&r);
    return hn_get_end(&r, elements > 16 ? elements - 16 : 0) && asked->axes > 0 &&
           (asked->has_parts || asked->axes <= HN_MOST_AXES) &&
           (asked->ticket.at == NULL || asked->ticket.size == HN_TICKET_BYTES);
}

bool hn_read_answer(hn_bytes body, uint32_t kind, hn_answer *answer)
{
    hn_reader r = hn_read_from(body);
    unsigned elements = hn_get_array(&r, 2);
    answer->nonce = hn_get_uint32(&r);
    answer->bytes = hn_get_bytes(&r);
    return hn_get_end(&r, elements - 2) && (kind != HN_COOKIE || answer->bytes.size == HN_COOKIE_BYTES);
}

bool hn_read_grant(hn_bytes packed, hn_grant *grant)
{
    hn_reader r = hn_read_from(packed);
    unsigned elements = hn_get_array(&r, 8);
    grant->session = hn_get_uint32(&r);
    grant->rate_hz = hn_get_number(&r);
    grant->keepalive_us = (uint32_t)hn_get_uint(&r, HN_MOST_KEEPALIVE_US);
    grant->scene = hn_get_text(&r, HN_NAME_BYTES);
    grant->ticket = hn_get_bytes(&r);
    grant->resumed = hn_get_bool(&r);
    grant->announced = hn_get_bool(&r);
    grant->position_share = hn_get_number(&r);
    grant->predicted = elements > 8 && hn_get_bool(&r);
    grant->vibrates = elements > 9 && hn_get_bool(&r);
    grant->frame = (hn_bytes){NULL, 0};
    if (elements > 10 && !hn_get_nil(&r))
        grant->frame = hn_get_text(&r, HN_NAME_BYTES);
    double share = grant->position_share;
    return hn_get_end(&r, elements > 11 ? elements - 11 : 0) && grant->session > 0 &&
           grant->keepalive_us >= HN_LEAST_KEEPALIVE_US && grant->ticket.size == HN_TICKET_BYTES &&
           HN_LEAST_RATE_HZ <= grant->rate_hz && grant->rate_hz <= HN_MOST_RATE_HZ &&
           (share == 0.0 || (HN_LEAST_SHARE <= share && share <= HN_MOST_SHARE));
}

bool hn_read_ending(hn_bytes body, uint32_t kind, hn_ending *ending)
{
    hn_reader r = hn_read_from(body);
    unsigned fields = kind == HN_REFUSE ? 3 : 2, elements = hn_get_array(&r, fields);
    ending->nonce = kind == HN_REFUSE ? hn_get_uint32(&r) : 0;
    ending->reason = hn_get_text(&r, HN_REASON_BYTES);
    ending->code = hn_get_uint32(&r);
    ending->has_shapes = kind == HN_NOTICE && elements > fields && !hn_get_nil(&r);
    if (ending->has_shapes)
        hn_get_bytes(&r);
    return hn_get_end(&r, elements - fields - (kind == HN_NOTICE && elements > fields));
}

bool hn_read_position(hn_bytes body, hn_position *position)
{
    hn_reader r = hn_read_from(body);
    unsigned elements = hn_get_array(&r, 3), fields = elements > 6 ? 6 : elements;
    memset(position, 0, sizeof *position);
    position->t_us = hn_get_uint32(&r);
    position->newest = hn_get_maybe(&r);
    position->payload = hn_get_bytes(&r);
    position->reports = fields >= 5;
    if (position->reports) {
        position->share = (uint32_t)hn_get_uint(&r, HN_MOST_PERCENT);
        position->again = (uint32_t)hn_get_uint(&r, HN_MOST_PERCENT);
    }
    if (fields == 4 || fields == 6)
        position->waited_ms = (uint32_t)hn_get_uint(&r, HN_MOST_WAITED_MS);
    return hn_get_end(&r, elements - fields);
}

/* Read the optional bound, bytes or nil. */
static bool get_bound_and_end(hn_reader *r, unsigned elements, hn_bytes *bound)
{
    *bound = (hn_bytes){NULL, 0};
    if (elements > 0 && !hn_get_nil(r))
        *bound = hn_get_bytes(r);
    return hn_get_end(r, elements > 0 ? elements - 1 : 0);
}

bool hn_read_force(hn_bytes body, hn_force *force)
{
    hn_reader r = hn_read_from(body);
    unsigned elements = hn_get_array(&r, 2);
    force->t_us = hn_get_uint32(&r);
    force->payload = hn_get_bytes(&r);
    return get_bound_and_end(&r, elements - 2, &force->bound);
}

bool hn_read_keepalive(hn_bytes body, hn_keepalive *keepalive)
{
    hn_reader r = hn_read_from(body);
    unsigned elements = hn_get_array(&r, 2);
    keepalive->t_us = hn_get_uint32(&r);
    keepalive->newest_force = hn_get_maybe(&r);
    return get_bound_and_end(&r, elements - 2, &keepalive->bound);
}

static hn_bytes written(const hn_writer *w, const uint8_t *start)
{
    return (hn_bytes){start, w->ok ? (size_t)(w->at - start) : 0};
}

size_t hn_write_frame(uint8_t *data, uint32_t kind, uint32_t session, uint32_t sequence, hn_bytes body)
{
    hn_writer w = hn_write_to(data, HN_DATAGRAM_BYTES);
    hn_put_array(&w, 5);
    hn_put_uint(&w, OPEN_VERSION);
    hn_put_uint(&w, kind);
    hn_put_uint(&w, session);
    hn_put_uint(&w, sequence);
    hn_put_bytes(&w, body.at, body.size);
    return written(&w, data).size;
}

static size_t write_hello(uint8_t *data, uint32_t sequence, const hn_hello *hello, size_t padding)
{
    static const uint8_t zeros[HN_HELLO_BYTES];
    uint8_t body[HN_DATAGRAM_BYTES];
    hn_writer w = hn_write_to(body, sizeof body);
    hn_put_array(&w, 5);
    hn_put_uint(&w, hello->nonce);
    hn_put_bytes(&w, hello->cookie.at, hello->cookie.size);
    hn_put_bytes(&w, hello->request.at, hello->request.size);
    hn_put_bytes(&w, hello->mac.at, hello->mac.size);
    hn_put_bytes(&w, zeros, padding);
    return hn_write_frame(data, HN_HELLO, 0, sequence, written(&w, body));
}

size_t hn_write_hello(uint8_t *data, uint32_t sequence, const hn_hello *hello)
{
    size_t bare = write_hello(data, sequence, hello, 0);
    return write_hello(data, sequence, hello, bare < HN_HELLO_BYTES ? HN_HELLO_BYTES - bare : 0);
}

size_t hn_write_answer(uint8_t *data, uint32_t kind, uint32_t session, uint32_t sequence, const hn_answer *answer)
{
    uint8_t body[HN_DATAGRAM_BYTES];
    hn_writer w = hn_write_to(body, sizeof body);
    hn_put_array(&w, 2);
    hn_put_uint(&w, answer->nonce);
    hn_put_bytes(&w, answer->bytes.at, answer->bytes.size);
    return hn_write_frame(data, kind, session, sequence, written(&w, body));
}

size_t hn_write_ending(uint8_t *data, uint32_t kind, uint32_t session, uint32_t sequence, const hn_ending *ending)
{
    uint8_t body[HN_REASON_BYTES + 16];
    hn_writer w = hn_write_to(body, sizeof body);
    hn_put_array(&w, kind == HN_REFUSE ? 3 : 2);
    if (kind == HN_REFUSE)
        hn_put_uint(&w, ending->nonce);
    hn_put_text(&w, (const char *)ending->reason.at, ending->reason.size);
    hn_put_uint(&w, ending->code);
    return hn_write_frame(data, kind, session, sequence, written(&w, body));
}

size_t hn_write_position(uint8_t *data, uint32_t session, uint32_t sequence, const hn_position *position)
{
    uint8_t body[64];
    hn_writer w = hn_write_to(body, sizeof body);
    hn_put_array(&w, 3u + (position->reports ? 2u : 0u) + (position->waited_ms > 0 ? 1u : 0u));
    hn_put_uint(&w, position->t_us);
    hn_put_maybe(&w, position->newest);
    hn_put_bytes(&w, position->payload.at, position->payload.size);
    if (position->reports) {
        hn_put_uint(&w, position->share);
        hn_put_uint(&w, position->again);
    }
    if (position->waited_ms > 0)
        hn_put_uint(&w, position->waited_ms);
    return hn_write_frame(data, HN_POSITION, session, sequence, written(&w, body));
}

size_t hn_write_force(uint8_t *data, uint32_t session, uint32_t sequence, const hn_force *force)
{
    uint8_t body[HN_DATAGRAM_BYTES];
    hn_writer w = hn_write_to(body, sizeof body);
    hn_put_array(&w, force->bound.at != NULL ? 3 : 2);
    hn_put_uint(&w, force->t_us);
    hn_put_bytes(&w, force->payload.at, force->payload.size);
    if (force->bound.at != NULL)
        hn_put_bytes(&w, force->bound.at, force->bound.size);
    return hn_write_frame(data, HN_FORCE, session, sequence, written(&w, body));
}

size_t hn_write_keepalive(uint8_t *data, uint32_t session, uint32_t sequence, const hn_keepalive *keepalive)
{
    uint8_t body[64];
    hn_writer w = hn_write_to(body, sizeof body);
    hn_put_array(&w, keepalive->bound.at != NULL ? 3 : 2);
    hn_put_uint(&w, keepalive->t_us);
    hn_put_maybe(&w, keepalive->newest_force);
    if (keepalive->bound.at != NULL)
        hn_put_bytes(&w, keepalive->bound.at, keepalive->bound.size);
    return hn_write_frame(data, HN_KEEPALIVE, session, sequence, written(&w, body));
}

hn_bytes hn_pack_asked(uint8_t *packed, size_t size, const hn_asked *asked)
{
    hn_writer w = hn_write_to(packed, size);
    hn_put_array(&w, asked->predicted ? 13 : 12);
    hn_put_text(&w, (const char *)asked->codec.at, asked->codec.size);
    hn_put_map(&w, asked->count);
    for (unsigned i = 0; i < asked->count; i++) {
        hn_put_text(&w, (const char *)asked->parameters[i].name.at, asked->parameters[i].name.size);
        hn_put_double(&w, asked->parameters[i].value);
    }
    hn_put_double(&w, asked->weber_fraction);
    hn_put_double(&w, asked->floor_n);
    hn_put_double(&w, asked->multiplier);
    hn_put_double(&w, asked->rate_hz);
    hn_put_uint(&w, asked->axes);
    hn_put_text(&w, (const char *)asked->name.at, asked->name.size);
    if (asked->ticket.at != NULL)
        hn_put_bytes(&w, asked->ticket.at, asked->ticket.size);
    else
        hn_put_nil(&w);
    hn_put_uint(&w, asked->clock_us);
    hn_put_bool(&w, asked->announced);
    hn_put_double(&w, asked->position_share);
    if (asked->predicted)
        hn_put_bool(&w, true);
    return written(&w, packed);
}

hn_bytes hn_pack_grant(uint8_t *packed, size_t size, const hn_grant *grant)
{
    hn_writer w = hn_write_to(packed, size);
    unsigned optional = grant->frame.at != NULL ? 3 : grant->vibrates ? 2 : grant->predicted ? 1 : 0;
    hn_put_array(&w, 8 + optional);
    hn_put_uint(&w, grant->session);
    hn_put_double(&w, grant->rate_hz);
    hn_put_uint(&w, grant->keepalive_us);
    hn_put_text(&w, (const char *)grant->scene.at, grant->scene.size);
    hn_put_bytes(&w, grant->ticket.at, grant->ticket.size);
    hn_put_bool(&w, grant->resumed);
    hn_put_bool(&w, grant->announced);
    hn_put_double(&w, grant->position_share);
    if (optional >= 1)
        hn_put_bool(&w, grant->predicted);
    if (optional >= 2)
        hn_put_bool(&w, grant->vibrates);
    if (optional >= 3)
        hn_put_text(&w, (const char *)grant->frame.at, grant->frame.size);
    return written(&w, packed);
}

hn_bytes hn_text(const char *text)
{
    return (hn_bytes){(const uint8_t *)text, strlen(text)};
}

void hn_copy_text(char *copy, size_t size, hn_bytes text)
{
    size_t length = text.size < size ? text.size : size - 1;
    if (length > 0)
        memcpy(copy, text.at, length);
    copy[length] = '\0';
}

int64_t hn_distance(uint32_t newer, uint32_t older)
{
    uint32_t ahead = newer - older;
    return ahead < UINT32_C(1) << 31 ? (int64_t)ahead : (int64_t)ahead - (INT64_C(1) << 32);
}

int64_t hn_unwrap(uint32_t number, int64_t near)
{
    return near + hn_distance(number, (uint32_t)(uint64_t)near);
}
