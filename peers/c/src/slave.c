/* The slave: docs/refer/protocol.md, "How a session begins" and "What the slave does". */
#include <math.h>
#include <string.h>

#include "arrivals.h"
#include "encoder.h"
#include "messages.h"
#include "repair.h"

static bool is_at(const hn_address *address, const hn_address *other)
{
    return address->size == other->size && memcmp(address->bytes, other->bytes, address->size) == 0;
}

static void draw(hn_slave *s, uint8_t *bytes, unsigned size)
{
    for (unsigned i = 0; i < size; i += 4) {
        uint32_t bits = s->entropy(s->context);
        memcpy(bytes + i, &bits, 4);
    }
}

static uint32_t draw_number(hn_slave *s)
{
    uint32_t number;
    do
        number = s->entropy(s->context);
    while (number < UINT32_C(1) << 16);
    return number;
}

static uint32_t version(const hn_slave *s)
{
    return s->sealing != NULL ? 2 : 1;
}

/* Mark a datagram that no seal covers with the version of its HELLO. */
static size_t with_version(const hn_slave *s, uint8_t *data, size_t size)
{
    data[1] = (uint8_t)version(s);
    return size;
}

/* Seal a datagram of the session, or of the half-open one. */
static size_t sealed(const hn_slave *s, bool half_open, uint8_t *data, size_t size)
{
    return s->sealing == NULL ? size : s->sealing->seal(s->keys, half_open, data, size);
}

static size_t refuse(uint8_t *answer, uint32_t nonce, unsigned code, const char *reason)
{
    hn_ending refusal = {.nonce = nonce, .reason = hn_text(reason), .code = code};
    return hn_write_ending(answer, HN_REFUSE, 0, 0, &refusal);
}

static bool is_in(double value, double least, double most)
{
    return least <= value && value <= most;
}

/* Take the numbers of a request; return NULL or what is wrong with one. */
static const char *number_wrong(const hn_asked *asked, hn_settings *settings)
{
    const char *wrong = NULL;
    hn_set_defaults(settings);
    for (unsigned i = 0; i < asked->count && wrong == NULL; i++)
        wrong = hn_set(settings, asked->parameters[i].name, asked->parameters[i].value);
    if (wrong == NULL)
        wrong = hn_law_wrong(settings);
    if (wrong != NULL)
        return wrong;
    if (!is_in(asked->rate_hz, HN_LEAST_RATE_HZ, HN_MOST_RATE_HZ))
        return HN_WRONG_RATE_HZ;
    if (asked->position_share != 0.0 && !is_in(asked->position_share, HN_LEAST_SHARE, HN_MOST_SHARE))
        return HN_WRONG_POSITION_SHARE;
    if (asked->vibrates && !is_in(asked->vibration_budget, HN_LEAST_VIBRATION_BUDGET, HN_MOST_VIBRATION_BUDGET))
        return HN_WRONG_VIBRATION_BUDGET;
    if (asked->vibrates && !is_in(asked->vibration_threshold, HN_LEAST_VIBRATION, HN_MOST_VIBRATION))
        return HN_WRONG_VIBRATION_THRESHOLD;
    return NULL;
}

/* Take the settings of a request; return 0 or, with a reason, the code with which it is refused. */
static unsigned refusal_of(const hn_slave *s, const hn_asked *asked, hn_settings *settings, const char **reason)
{
    *settings = (hn_settings){
        .codec = hn_codec_named(asked->codec),
        .axes = asked->axes,
        .weber_fraction = asked->weber_fraction,
        .floor_n = asked->floor_n,
        .multiplier = asked->multiplier,
    };
    *reason = "this slave has the codecs deadband and raw";
    if (settings->codec != HN_CODEC_DEADBAND && settings->codec != HN_CODEC_RAW)
        return HN_CODE_CODEC;
    *reason = "this slave has no couplings";
    if (asked->coupled)
        return HN_CODE_CODEC;
    *reason = number_wrong(asked, settings);
    if (*reason != NULL)
        return HN_CODE_PARAMETER;
    *reason = s->axes == 1   ? "axes must be 1, as the scene's"
              : s->axes == 2 ? "axes must be 2, as the scene's"
                             : "axes must be 3, as the scene's";
    if (asked->axes != s->axes)
        return HN_CODE_AXES;
    *reason = "the scene has no parts but one force";
    return asked->has_parts ? HN_CODE_AXES : 0;
}

/* Write the WELCOME of the half-open session: in a sealed one, the Noise message that was made for it. */
static size_t write_welcome(const hn_slave *s, hn_bytes granted, uint32_t nonce, uint32_t session, uint8_t *answer)
{
    hn_answer welcome = {nonce, granted};
    return with_version(s, answer, hn_write_answer(answer, HN_WELCOME, session, 0, &welcome));
}

static hn_bytes pack_grant(const hn_slave *s, uint8_t *packed, size_t size)
{
    const hn_greeting *g = &s->half_open;
    hn_grant grant = {
        .session = g->number,
        .rate_hz = g->rate_hz,
        .keepalive_us = HN_KEEPALIVE_US,
        .scene = hn_text(s->scene),
        .ticket = {g->ticket, HN_TICKET_BYTES},
        .resumed = g->continues,
    };
    return hn_pack_grant(packed, size, &grant);
}

/* Write the WELCOME of the half-open session, or the same again. */
static size_t welcome(hn_slave *s, bool again, uint8_t *answer)
{
    uint8_t packed[HN_NAME_BYTES + 64];
    hn_bytes granted = pack_grant(s, packed, sizeof packed);
    if (s->sealing != NULL && !again) {
        s->half_open.noise2_size = s->sealing->answer(s, granted.at, granted.size, &s->half_open.noise2);
        s->sealing->use(s->keys, true);
    }
    if (s->sealing != NULL)
        granted = (hn_bytes){s->half_open.noise2, s->half_open.noise2_size};
    if (granted.size == 0)
        return 0;
    return write_welcome(s, granted, s->half_open.nonce, s->half_open.number, answer);
}

/* Refuse a request that was read: under the seal, if there is one. */
static size_t refuse_request(hn_slave *s, uint32_t nonce, unsigned code, const char *reason, uint8_t *answer)
{
    uint8_t packed[HN_REASON_BYTES + 16];
    const uint8_t *noise2;
    if (s->sealing == NULL)
        return refuse(answer, nonce, code, reason);
    hn_writer w = hn_write_to(packed, sizeof packed);
    hn_put_array(&w, 3);
    hn_put_uint(&w, 0);
    hn_put_text(&w, reason, strlen(reason));
    hn_put_uint(&w, code);
    size_t size = s->sealing->answer(s, packed, (size_t)(w.at - packed), &noise2);
    s->half_open.noise2_size = 0; /* its WELCOME is overwritten, and cannot be repeated */
    return write_welcome(s, (hn_bytes){noise2, size}, nonce, 0, answer);
}

/* Whether the session must not end for the master of another one. */
static bool is_taken(hn_slave *s, bool continues, int64_t now_us)
{
    if (s->heard_us > now_us) /* the clock went back */
        s->heard_us = now_us;
    if (now_us - s->heard_us > HN_KEEP_US)
        s->open = false;
    return s->open && !continues && now_us - s->heard_us <= HN_GIVES_WAY_US;
}

/* Answer a HELLO whose sender has proved its address, and whose request was not read before. */
static size_t admit(hn_slave *s, const hn_hello *hello, uint32_t sequence, const hn_address *address, int64_t now_us,
                    uint8_t *answer)
{
    uint8_t plain[HN_DATAGRAM_BYTES];
    hn_asked asked;
    hn_settings settings;
    const char *reason = "this slave does not know the master's key";
    hn_bytes request = hello->request;
    if (s->sealing != NULL) {
        request.size = s->sealing->read(s->keys, hello->nonce, sequence, request.at, request.size, plain);
        request.at = plain;
    }
    if (!hn_read_asked(request, &asked)) {
        s->counts.malformed++;
        return 0;
    }
    unsigned code = s->sealing != NULL && !s->sealing->is_listed(s->keys) ? HN_CODE_KEY
                                                                          : refusal_of(s, &asked, &settings, &reason);
    if (code != 0)
        return refuse_request(s, hello->nonce, code, reason, answer);
    bool continues = s->open && asked.ticket.at != NULL && memcmp(asked.ticket.at, s->ticket, sizeof s->ticket) == 0;
    if (is_taken(s, continues, now_us))
        return refuse_request(s, hello->nonce, HN_CODE_FULL, "this slave serves another master", answer);
    s->half_open = (hn_greeting){
        .waits = true,
        .continues = continues,
        .address = *address,
        .nonce = hello->nonce,
        .number = draw_number(s),
        .first = sequence,
        .settings = settings,
        .rate_hz = fmin(asked.rate_hz, s->fastest_rate_hz),
        .clock_us = (int64_t)asked.clock_us,
        .heard_us = now_us,
    };
    draw(s, s->half_open.ticket, HN_TICKET_BYTES);
    return welcome(s, false, answer);
}

static hn_cookie *cookie_of(hn_slave *s, uint32_t nonce, const hn_address *address)
{
    for (unsigned i = 0; i < sizeof s->cookies / sizeof *s->cookies; i++)
        if (s->cookies[i].given && s->cookies[i].nonce == nonce && is_at(&s->cookies[i].address, address))
            return &s->cookies[i];
    return NULL;
}

/* Return the cookie of an address and a nonce; a new one takes the place of the oldest. */
static hn_cookie *give_cookie(hn_slave *s, uint32_t nonce, const hn_address *address)
{
    hn_cookie *cookie = cookie_of(s, nonce, address);
    if (cookie != NULL)
        return cookie;
    cookie = &s->cookies[s->next_cookie++ % (sizeof s->cookies / sizeof *s->cookies)];
    *cookie = (hn_cookie){.address = *address, .nonce = nonce, .given = true};
    draw(s, cookie->cookie, HN_COOKIE_BYTES);
    return cookie;
}

static size_t receive_hello(hn_slave *s, const hn_frame *frame, size_t size, const hn_address *address, int64_t now_us,
                            uint8_t *answer)
{
    hn_hello hello;
    uint32_t nonce;
    if (size < HN_HELLO_BYTES || !hn_read_nonce(frame->body, &nonce)) {
        s->counts.malformed++;
        return 0;
    }
    if (frame->version != version(s))
        return refuse(answer, nonce, frame->version == 1 || frame->version == 2 ? HN_CODE_KEY : HN_CODE_VERSION,
                      s->sealing != NULL ? "this slave serves sealed sessions only: version 2"
                                         : "this slave serves open sessions only: version 1");
    if (!hn_read_hello(frame->body, &hello) || (s->sealing != NULL && frame->sequence >= 1u << HN_EPOCH_BITS)) {
        s->counts.malformed++;
        return 0;
    }
    if (s->sealing != NULL && (hello.mac.size != 16 || !s->sealing->is_for_us(s->keys, nonce, frame->sequence,
                                                                              hello.request.at, hello.request.size,
                                                                              hello.mac.at))) {
        s->counts.stray++; /* its sender does not know this slave's key */
        return 0;
    }
    hn_cookie *cookie = give_cookie(s, nonce, address);
    if (hello.cookie.size != HN_COOKIE_BYTES || memcmp(hello.cookie.at, cookie->cookie, HN_COOKIE_BYTES) != 0) {
        hn_answer given = {nonce, {cookie->cookie, HN_COOKIE_BYTES}};
        return with_version(s, answer, hn_write_answer(answer, HN_COOKIE, 0, 0, &given));
    }
    if (s->half_open.waits && s->half_open.nonce == nonce && is_at(&s->half_open.address, address)) {
        s->half_open.heard_us = now_us;
        return welcome(s, true, answer);
    }
    if (cookie->spent) /* a request is read once */
        return 0;
    cookie->spent = true;
    return admit(s, &hello, frame->sequence, address, now_us, answer);
}

/* The first position opens the session, and ends the one before. */
static void open_session(hn_slave *s, int64_t now_us)
{
    const hn_greeting *g = &s->half_open;
    if (s->sealing != NULL)
        s->sealing->use(s->keys, false);
    s->open = true;
    s->half_open.waits = false;
    s->address = g->address;
    s->number = g->number;
    s->sequence = 1;
    memcpy(s->ticket, g->ticket, sizeof s->ticket);
    s->rate_hz = g->rate_hz;
    s->full_us = -INFINITY;
    s->newest_force.is_set = false;
    s->waits = false;
    s->heard_us = g->heard_us;
    s->position_t_us = g->clock_us;
    hn_arrivals_init(&s->arrivals, g->first, s->sealing != NULL);
    hn_encoder_init(&s->encoder, &g->settings);
    hn_repair_init(&s->repair, &g->settings, now_us);
}

/* Whether the rate allows another position; a bucket holds those of a second. */
static bool is_served(hn_slave *s, int64_t now_us)
{
    double now = (double)now_us, each_us = 1e6 / (HN_POLICED_SHARE * s->rate_hz);
    double most_us = fmax(32.0, HN_POLICED_BURST_S * s->rate_hz) * each_us;
    double full_us = fmax(s->full_us, now) + each_us;
    if (full_us - now > most_us) {
        if (full_us - now > most_us + each_us + 1.0) /* the clock went back: begin again, empty */
            s->full_us = now + most_us;
        return false;
    }
    s->full_us = full_us;
    return true;
}

static void receive_position(hn_slave *s, const hn_frame *frame, const hn_address *from, bool opens, int64_t now_us)
{
    hn_position position;
    hn_vector place_m;
    bool good = hn_read_position(frame->body, &position) && position.payload.size == 4 * s->axes;
    for (unsigned i = 0; i < s->axes && good; i++)
        place_m[i] = hn_read_single(position.payload.at + 4 * i);
    if (!good || !hn_in_range(place_m, s->axes)) {
        s->counts.malformed++;
        return;
    }
    if (opens)
        open_session(s, now_us);
    hn_arrival arrival = hn_arrive(&s->arrivals, frame->sequence);
    s->counts.stray += arrival == HN_ASTRAY;
    if (arrival == HN_NEW)
        s->address = *from; /* a sealed session follows its master */
    if (arrival != HN_NEW || !is_served(s, now_us))
        return;
    /* The present time of the master's clock: time stamps wrap, and a silent session may be older. */
    int64_t clock_us = s->position_t_us + (now_us > s->heard_us ? now_us - s->heard_us : 0);
    s->heard_us = now_us;
    if (position.newest.is_set)
        hn_repair_acknowledged(&s->repair, position.newest.value, now_us);
    if (position.reports)
        hn_repair_reported(&s->repair, position.share / 100.0, position.again / 100.0, now_us);
    s->position_t_us = hn_unwrap(position.t_us, clock_us);
    memcpy(s->position_m, place_m, s->axes * sizeof *place_m);
    s->waits = true;
}

static size_t write_close(hn_slave *s, const char *reason, unsigned code, uint8_t *datagram)
{
    hn_ending close = {.reason = hn_text(reason), .code = code};
    if (!hn_is_text(close.reason, HN_REASON_BYTES))
        close.reason.size = 0;
    s->open = s->waits = false;
    return sealed(s, false, datagram, hn_write_ending(datagram, HN_CLOSE, s->number, s->sequence++, &close));
}

/* Answer a CLOSE of the session, or of the half-open one. */
static size_t receive_close(hn_slave *s, const hn_frame *frame, bool half_open, uint8_t *answer)
{
    hn_ending close;
    if (!hn_read_ending(frame->body, HN_CLOSE, &close)) {
        s->counts.malformed++;
        return 0;
    }
    if (half_open) {
        hn_ending done = {.reason = hn_text("as asked")};
        s->half_open.waits = false;
        return sealed(s, true, answer, hn_write_ending(answer, HN_CLOSE, frame->session, 1, &done));
    }
    hn_arrival arrival = hn_arrive(&s->arrivals, frame->sequence);
    s->counts.stray += arrival == HN_ASTRAY;
    return arrival == HN_NEW ? write_close(s, "as asked", HN_CODE_OTHER, answer) : 0;
}

static size_t receive_data(hn_slave *s, hn_bytes data, hn_frame *frame, const hn_address *from, int64_t now_us,
                           uint8_t *answer)
{
    uint8_t plain[HN_DATAGRAM_BYTES];
    bool is_position = frame->kind == HN_POSITION, is_sealed = s->sealing != NULL;
    if (now_us - s->half_open.heard_us > HN_HALF_OPEN_US)
        s->half_open.waits = false;
    /* An open session is bound to its address. A sealed one is found by its number alone. */
    bool of_session = s->open && frame->session == s->number && (is_sealed || is_at(from, &s->address));
    bool half_open = s->half_open.waits && frame->session == s->half_open.number &&
                     (is_sealed || is_at(from, &s->half_open.address));
    if (frame->version != version(s) || !(of_session || half_open) || !(is_position || frame->kind == HN_CLOSE)) {
        s->counts.stray++;
        if (!(is_position || frame->kind == HN_CLOSE))
            return 0;
        size_t size = hn_write_frame(answer, HN_RESET, frame->session, frame->sequence, (hn_bytes){NULL, 0});
        answer[1] = (uint8_t)frame->version;
        return size;
    }
    if (is_sealed) {
        if (!s->sealing->open(s->keys, half_open, data.at, data.size, frame->sequence, frame->body.size, plain)) {
            s->counts.malformed++;
            return 0;
        }
        frame->body = (hn_bytes){plain, frame->body.size - HN_TAG_BYTES};
    }
    if (!is_position)
        return receive_close(s, frame, half_open, answer);
    if (half_open && is_taken(s, s->half_open.continues, now_us)) {
        hn_ending full = {.reason = hn_text("this slave serves another master"), .code = HN_CODE_FULL};
        s->half_open.waits = false;
        return sealed(s, true, answer, hn_write_ending(answer, HN_CLOSE, frame->session, 1, &full));
    }
    receive_position(s, frame, from, half_open, now_us);
    return 0;
}

size_t hn_slave_receive(hn_slave *s, const void *datagram, size_t size, const void *address, size_t address_size,
                        int64_t now_us, uint8_t answer[HN_DATAGRAM_BYTES])
{
    hn_bytes data = {datagram, size};
    hn_frame frame;
    hn_address from = {.size = address_size < HN_ADDRESS_BYTES ? address_size : HN_ADDRESS_BYTES};
    memcpy(from.bytes, address, from.size);
    if (!hn_read_frame(data, &frame)) {
        s->counts.malformed++;
        return 0;
    }
    if (frame.kind == HN_HELLO)
        return receive_hello(s, &frame, size, &from, now_us, answer);
    return receive_data(s, data, &frame, &from, now_us, answer);
}

bool hn_slave_position(const hn_slave *s, double position_m[])
{
    if (s->waits)
        memcpy(position_m, s->position_m, s->axes * sizeof *position_m);
    return s->waits;
}

size_t hn_slave_answer(hn_slave *s, const double force_n[], int64_t now_us, uint8_t answer[HN_DATAGRAM_BYTES])
{
    uint8_t payload[8 * HN_MOST_AXES];
    hn_vector before_n;
    if (!s->waits || (s->sealing != NULL && s->sequence > HN_LAST_SEQUENCE))
        return 0;
    if (!hn_in_range(force_n, s->axes))
        return write_close(s, "the scene gave a force that is not finite", HN_CODE_FAILED, answer);
    s->waits = false;
    uint32_t t_us = (uint32_t)(uint64_t)s->position_t_us;
    if (hn_repair_is_due(&s->repair, force_n, now_us))
        hn_encoder_refresh(&s->encoder);
    memcpy(before_n, s->encoder.held_n, sizeof before_n);
    size_t size = hn_encode(&s->encoder, force_n, payload);
    if (size > 0) {
        hn_force force = {.t_us = t_us, .payload = {payload, size}};
        s->newest_force = (hn_maybe){true, s->sequence};
        hn_repair_sent(&s->repair, HN_FORCE, s->sequence, before_n, now_us);
        return sealed(s, false, answer, hn_write_force(answer, s->number, s->sequence++, &force));
    }
    if (!hn_keepalive_is_due(&s->repair, now_us))
        return 0;
    hn_keepalive keepalive = {.t_us = t_us, .newest_force = s->newest_force};
    hn_repair_sent(&s->repair, HN_KEEPALIVE, s->sequence, before_n, now_us);
    return sealed(s, false, answer, hn_write_keepalive(answer, s->number, s->sequence++, &keepalive));
}

size_t hn_slave_close(hn_slave *s, const char *reason, unsigned code, uint8_t datagram[HN_DATAGRAM_BYTES])
{
    return s->open ? write_close(s, reason != NULL ? reason : "", code, datagram) : 0;
}

const char *hn_slave_init(hn_slave *s, const char *scene, unsigned axes, hn_entropy *entropy, void *context)
{
    const char *wrong = axes < 1 || axes > HN_MOST_AXES                                    ? HN_WRONG_AXES
                        : scene == NULL || !hn_is_text(hn_text(scene), HN_NAME_BYTES) ? HN_WRONG_SCENE
                                                                                           : NULL;
    memset(s, 0, sizeof *s);
    s->scene = wrong == NULL ? scene : "";
    s->axes = wrong == NULL ? axes : 0; /* it refuses every request then */
    s->fastest_rate_hz = HN_FASTEST_RATE_HZ;
    s->entropy = entropy;
    s->context = context;
    return wrong;
}

const void *hn_slave_master(const hn_slave *s, size_t *size)
{
    *size = s->address.size;
    return s->number != 0 ? s->address.bytes : NULL;
}

hn_counts hn_slave_counts(const hn_slave *s)
{
    return s->counts;
}
