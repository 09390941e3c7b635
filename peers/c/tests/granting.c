#include "granting.h"

#include <stdlib.h>
#include <string.h>

#include "more.h"

static struct {
    hn_request request; /* of the newest master */
    void *memory;
    bool follows; /* whether its codec is none of the slave's */
} asked;

void ask_for_more(hn_request *request)
{
    static const char *const codecs[] = {"motion-predictive", "deadband", "passive-interpolative", "model-mediated"};
    static unsigned masters;
    request->codec = codecs[masters++ % 4]; /* by turns, so that a short run has those that follow the hand */
    request->parameters[0].name = NULL;
    request->position_share = below(2) ? 0.25 : 0.0;
    request->announced = below(2);
    request->predicted = below(2);
    free(asked.memory);
    size_t size = hn_more_bytes(request);
    asked.memory = size > 0 ? malloc(size) : NULL; /* of the exact size, so that sanitizers see its end */
    request->more = size > 0 ? hn_more_init(asked.memory, request) : NULL;
    asked.follows = request->codec != codecs[1];
    asked.request = *request;
}

/* Write a model of some layers, mostly allowed; return its size. */
static size_t write_model(uint8_t *payload, unsigned axes)
{
    uint8_t *at = payload + 2;
    payload[0] = 1;
    payload[1] = (uint8_t)below(4);
    for (unsigned i = 0; i < payload[1]; i++) {
        unsigned flags = below(64), values = 2 + (flags >> 1 & 1) + (flags >> 2 & 1) + (flags >> 3 & 1);
        values += (flags & 16 ? 3u : 0u) + (flags & 32 ? 2u : 0u);
        *at++ = (uint8_t)flags;
        for (unsigned value = 0; value < values; value++, at += 4)
            hn_store_single(at, value == 0 ? 1e-3 * below(30) : value == 1 ? 300.0 : 1e-2 * (1 + below(100)));
        for (unsigned axis = 0; axis < axes && axes > 1; axis++, at += 4)
            hn_store_single(at, axis == i % axes);
    }
    return (size_t)(at - payload);
}

/* Write a payload that some codec reads, or a bound. */
static size_t write_some(uint8_t *payload, size_t size, bool is_wide)
{
    payload[0] = (uint8_t)below(4);
    for (size_t i = is_wide ? 0 : 1; i + 4 <= size; i += 4)
        hn_store_single(payload + i, 1e-3 * below(5000));
    return size;
}

static size_t granted(uint8_t *data, const hn_frame *frame)
{
    uint8_t packed[HN_DATAGRAM_BYTES];
    hn_answer welcome;
    hn_grant grant;
    if (!hn_read_answer(frame->body, HN_WELCOME, &welcome) || !hn_read_grant(welcome.bytes, &grant))
        return 0;
    grant.announced = asked.request.announced && below(8) > 0;
    grant.predicted = asked.request.predicted && below(2) > 0;
    grant.position_share = below(8) > 0 ? asked.request.position_share : 0.0;
    welcome.bytes = hn_pack_grant(packed, sizeof packed, &grant);
    return hn_write_answer(data, HN_WELCOME, frame->session, frame->sequence, &welcome);
}

static size_t answered(uint8_t *data, const hn_frame *frame)
{
    uint8_t payload[400], bound[40];
    unsigned axes = asked.request.axes, head = asked.request.announced;
    hn_force force;
    hn_keepalive keepalive;
    size_t size = 12 + 8 * axes;
    write_some(bound, size, true);
    for (unsigned i = 0; i < axes; i++)
        hn_store_single(bound + 12 + 4 * i, -1e-2 * below(3));
    hn_bytes news = {below(8) == 0 ? bound : NULL, below(4) > 0 ? size : 0};
    if (frame->kind == HN_KEEPALIVE && hn_read_keepalive(frame->body, &keepalive)) {
        keepalive.bound = news;
        return hn_write_keepalive(data, frame->session, frame->sequence, &keepalive);
    }
    if (frame->kind != HN_FORCE || !hn_read_force(frame->body, &force) || force.payload.size > 64)
        return 0;
    force.bound = news;
    payload[0] = 0;
    if (head && below(3) == 0)
        size = write_model(payload, axes);
    else if (asked.follows)
        size = head + write_some(payload + head, 1 + 4 * axes + (below(2) ? 2 * axes + 2 : 0), below(3) == 0);
    else
        memcpy(payload + head, force.payload.at, (size = head + force.payload.size) - head);
    force.payload = (hn_bytes){payload, size};
    return hn_write_force(data, frame->session, frame->sequence, &force);
}

size_t with_more(uint8_t *data, size_t size)
{
    uint8_t copy[HN_DATAGRAM_BYTES];
    hn_frame frame;
    memcpy(copy, data, size);
    if (asked.memory == NULL || !hn_read_frame((hn_bytes){copy, size}, &frame))
        return size;
    size_t changed = frame.kind == HN_WELCOME ? granted(data, &frame) : answered(data, &frame);
    return changed > 0 ? changed : size;
}

size_t without_more(uint8_t *data, size_t size)
{
    uint8_t copy[HN_DATAGRAM_BYTES], packed[HN_DATAGRAM_BYTES];
    hn_frame frame;
    hn_hello hello;
    hn_asked request;
    hn_position position;
    memcpy(copy, data, size);
    if (asked.memory == NULL || !hn_read_frame((hn_bytes){copy, size}, &frame))
        return size;
    if (frame.kind == HN_HELLO && hn_read_hello(frame.body, &hello) && hn_read_asked(hello.request, &request)) {
        request.codec = hn_text("deadband");
        request.count = 0;
        hello.request = hn_pack_asked(packed, sizeof packed, &request);
        return hn_write_hello(data, frame.sequence, &hello);
    }
    if (frame.kind == HN_POSITION && hn_read_position(frame.body, &position)) {
        position.payload.at += position.payload.size % 2; /* the state of a model, before two axes */
        position.payload.size = 4 * asked.request.axes;
        return hn_write_position(data, frame.session, frame.sequence, &position);
    }
    return size;
}
