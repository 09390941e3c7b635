/* What the tests reach the library by: the sizes of its states, and functions whose arguments ctypes can give. */
#include <string.h>

#include "decoder.h"
#include "hapticnet_sealed.h"
#include "more.h"

size_t shim_bytes(const char *what)
{
    if (strcmp(what, "master") == 0)
        return sizeof(hn_master);
    if (strcmp(what, "keys") == 0)
        return sizeof(hn_master_keys);
    if (strcmp(what, "slave keys") == 0)
        return sizeof(hn_slave_keys);
    if (strcmp(what, "model") == 0)
        return sizeof(hn_model);
    return strcmp(what, "slave") == 0 ? sizeof(hn_slave) : sizeof(hn_decoder);
}

bool shim_decoder(hn_decoder *d, const char *codec, unsigned axes, double weber_fraction, double floor_n,
                  double multiplier, unsigned count, const char *const names[], const double values[])
{
    hn_settings s = {hn_codec_named(hn_text(codec)), axes, {0}, weber_fraction, floor_n, multiplier};
    bool good = s.codec != HN_CODEC_UNKNOWN && hn_law_wrong(&s) == NULL;
    hn_set_defaults(&s);
    for (unsigned i = 0; i < count; i++)
        good = good && hn_set(&s, hn_text(names[i]), values[i]) == NULL;
    hn_decoder_init(d, &s);
    return good;
}

bool shim_decode(hn_decoder *d, int64_t t_us, const uint8_t *payload, size_t size)
{
    return hn_decode(d, t_us, (hn_bytes){payload, size});
}

void shim_apply(hn_decoder *d, int64_t t_us, const double *position_m, double *stimulus_n)
{
    if (hn_follows_motion(d->settings.codec))
        hn_decoder_move(d, t_us, position_m);
    hn_decoder_apply(d, t_us, stimulus_n);
}

void shim_set_sequence(hn_master *m, uint32_t sequence)
{
    m->now->sequence = sequence;
}

/* Give what the decoder of a master applies, before the hold. */
void shim_received(hn_master *m, int64_t now_us, double *stimulus_n)
{
    hn_vector force_n;
    hn_master_force(m, force_n, now_us);
    memcpy(stimulus_n, m->hold.stimulus_n, m->request.axes * sizeof *stimulus_n);
}

/* Read a model for a rate of 1000 Hz. */
bool shim_read_model(hn_model *model, const uint8_t *payload, size_t size, unsigned axes)
{
    return hn_read_model((hn_bytes){payload, size}, axes, hn_stiffest(1000.0), model);
}

/* Read a line or a bound. */
bool shim_read_line(const uint8_t *payload, size_t size, unsigned axes, int64_t t_us, double *place_m)
{
    hn_line line;
    if (!hn_read_promise((hn_bytes){payload, size}, axes, &line))
        return false;
    hn_line_at(&line, t_us, axes, place_m);
    return true;
}

bool shim_read_bound(const uint8_t *payload, size_t size, unsigned axes)
{
    bool has;
    hn_bound bound;
    return hn_read_bound((hn_bytes){payload, size}, axes, &has, &bound);
}

/* Begin a model at a position, or step it there. */
void shim_model(hn_model *model, bool begins, int64_t t_us, const double *position_m, int64_t before_us,
                const double *before_m, double *force_n)
{
    if (begins)
        hn_model_begin(model, t_us, position_m, before_us, before_m);
    else
        hn_model_step(model, t_us, position_m);
    memcpy(force_n, model->force_n, model->axes * sizeof *force_n);
}

bool shim_is_text(const uint8_t *data, size_t size)
{
    return hn_is_text((hn_bytes){data, size}, SIZE_MAX);
}

static size_t repack_hello(uint8_t *out, const hn_frame *frame)
{
    uint8_t packed[HN_DATAGRAM_BYTES];
    hn_hello hello;
    hn_asked asked;
    if (!hn_read_hello(frame->body, &hello) || !hn_read_asked(hello.request, &asked))
        return 0;
    hello.request = hn_pack_asked(packed, sizeof packed, &asked);
    return hn_write_hello(out, frame->sequence, &hello);
}

static size_t repack_answer(uint8_t *out, const hn_frame *frame)
{
    uint8_t packed[HN_DATAGRAM_BYTES];
    hn_answer answer;
    hn_grant grant;
    if (!hn_read_answer(frame->body, frame->kind, &answer))
        return 0;
    if (frame->kind == HN_WELCOME) {
        if (!hn_read_grant(answer.bytes, &grant))
            return 0;
        answer.bytes = hn_pack_grant(packed, sizeof packed, &grant);
    }
    return hn_write_answer(out, frame->kind, frame->session, frame->sequence, &answer);
}

/* Read a datagram and write what was read; return its size, or 0 if it must be refused. */
size_t shim_repack(const uint8_t *data, size_t size, uint8_t *out)
{
    hn_frame frame;
    hn_position position;
    hn_force force;
    hn_keepalive keepalive;
    hn_ending ending;
    if (!hn_read_frame((hn_bytes){data, size}, &frame))
        return 0;
    switch (frame.kind) {
    case HN_HELLO:
        return repack_hello(out, &frame);
    case HN_COOKIE:
    case HN_WELCOME:
        return repack_answer(out, &frame);
    case HN_POSITION:
        if (!hn_read_position(frame.body, &position))
            return 0;
        return hn_write_position(out, frame.session, frame.sequence, &position);
    case HN_FORCE:
        if (!hn_read_force(frame.body, &force))
            return 0;
        return hn_write_force(out, frame.session, frame.sequence, &force);
    case HN_KEEPALIVE:
        if (!hn_read_keepalive(frame.body, &keepalive))
            return 0;
        return hn_write_keepalive(out, frame.session, frame.sequence, &keepalive);
    case HN_RESET:
        return hn_write_frame(out, HN_RESET, frame.session, frame.sequence, frame.body);
    default:
        if (!hn_read_ending(frame.body, frame.kind, &ending))
            return 0;
        return hn_write_ending(out, frame.kind, frame.session, frame.sequence, &ending);
    }
}

/* Pretend that a master's first session has come to an epoch, with the key that it has. */
void shim_set_epoch(hn_master_keys *keys, uint32_t epoch)
{
    keys->transports[0].send_epoch = epoch;
}
