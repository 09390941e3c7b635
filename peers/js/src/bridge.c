/* What TypeScript calls: one master and one slave, whose states are static, and memory for what passes between.
 *
 * Each object of the package has an instance of its own, so nothing is allocated. Times come as doubles, which hold
 * every microsecond of 285 years. */
#include <string.h>

#include "decoder.h"
#include "hapticnet_sealed.h"
#include "messages.h"

#define EXPORT(name) __attribute__((export_name(#name)))

enum { TEXT_BYTES = 1024, PAGE_BYTES = 65536 };

static struct {
    uint8_t data[HN_DATAGRAM_BYTES + 8]; /* what arrives, a byte more at most, so that it is seen to be too long; why to end */
    uint8_t answer[HN_DATAGRAM_BYTES];   /* what is sent */
    char text[TEXT_BYTES];               /* the texts of a request or a slave, which stay; each ends with a zero */
    double numbers[HN_MOST_PARAMETERS + 8];
    uint8_t address[HN_ADDRESS_BYTES];
    hn_key keys[3];
    hn_counts counts;
    unsigned code;
} io;

static hn_master master;
static hn_master_keys master_keys;
static hn_slave slave;
static hn_slave_keys slave_keys;

__attribute__((import_name("random32"))) uint32_t random_from_host(void);

static uint32_t random32(void *context)
{
    (void)context;
    return random_from_host();
}

EXPORT(data) void *data(void) { return io.data; }
EXPORT(answer) void *answer(void) { return io.answer; }
EXPORT(text) void *text(void) { return io.text; }
EXPORT(numbers) void *numbers(void) { return io.numbers; }
EXPORT(address) void *address(void) { return io.address; }
EXPORT(keys) void *keys(void) { return io.keys; }
EXPORT(counts) void *counts(void) { return &io.counts; }

static const char *next_text(const char **at)
{
    const char *first = *at;
    *at += strlen(first) + 1;
    return first;
}

/* Read a request. `text` has codec and name, and the name of each parameter; `numbers` the law's three, the rate, the
 * axes, the share of few positions, whether contact is announced and the hand predicted, and the value of each
 * parameter. */
static hn_request read_request(unsigned parameters)
{
    const char *at = io.text;
    hn_request request = {
        .codec = next_text(&at),
        .name = next_text(&at),
        .weber_fraction = io.numbers[0],
        .floor_n = io.numbers[1],
        .multiplier = io.numbers[2],
        .rate_hz = io.numbers[3],
        .axes = (unsigned)io.numbers[4],
        .position_share = io.numbers[5],
        .announced = io.numbers[6] != 0.0,
        .predicted = io.numbers[7] != 0.0,
    };
    for (unsigned i = 0; i < parameters; i++)
        request.parameters[i] = (hn_parameter){next_text(&at), io.numbers[8 + i]};
    return request;
}

/* Start the master; return what is wrong with the request, or NULL. */
EXPORT(masterInit) const char *master_init(unsigned parameters)
{
    hn_request request = read_request(parameters);
    size_t bytes = hn_more_bytes(&request), pages = (bytes + PAGE_BYTES - 1) / PAGE_BYTES;
    if (bytes > 0)
        request.more = hn_more_init((void *)(__builtin_wasm_memory_grow(0, pages) * PAGE_BYTES), &request);
    return hn_master_init(&master, &request, random32, NULL);
}

/* `keys` has the master's private key, the slave's public key and, if there is one, the key that both share. */
EXPORT(masterSeal) bool master_seal(bool has_psk)
{
    return hn_master_seal(&master, &master_keys, io.keys[0], io.keys[1], has_psk ? io.keys[2] : NULL) == NULL;
}

EXPORT(masterTick) void master_tick(double now_us, bool has_position)
{
    hn_master_tick(&master, has_position ? io.numbers : NULL, (int64_t)now_us);
}

EXPORT(masterForce) void master_force(double now_us) { hn_master_force(&master, io.numbers, (int64_t)now_us); }

EXPORT(masterSend) size_t master_send(void) { return hn_master_send(&master, io.answer); }

EXPORT(masterReceive) void master_receive(size_t size, double now_us)
{
    hn_master_receive(&master, io.data, size, (int64_t)now_us);
}

/* `data` has why. */
EXPORT(masterClose) void master_close(double now_us)
{
    hn_master_close(&master, (const char *)io.data, (int64_t)now_us);
}

EXPORT(masterState) hn_state master_state(void) { return hn_master_state(&master); }
EXPORT(masterScene) const char *master_scene(void) { return hn_master_scene(&master); }
EXPORT(masterReason) const char *master_reason(void) { return hn_master_reason(&master, &io.code); }
EXPORT(masterCode) unsigned master_code(void) { return io.code; } /* of the reason that was read */

/* Return what the newest session was granted, 1 for few positions, 2 for a predicted hand and 4 for announced contact
 * added; -1 before the first session. */
EXPORT(masterGranted) int master_granted(void)
{
    const hn_stream *s = master.now;
    return !master.had_session ? -1 : s->sparse + 2 * s->predicted + 4 * s->announced;
}

EXPORT(masterCounts) void master_counts(void) { io.counts = hn_master_counts(&master); }

/* `text` has the scene's name. Return what is wrong, or NULL. */
EXPORT(slaveInit) const char *slave_init(unsigned axes)
{
    return hn_slave_init(&slave, io.text, axes, random32, NULL);
}

/* `keys` has the slave's private key; the masters that it serves are at `listed`. */
EXPORT(slaveSeal) bool slave_seal(const hn_listed *listed, size_t count)
{
    return hn_slave_seal(&slave, &slave_keys, io.keys[0], listed, count) == NULL;
}

EXPORT(slaveReceive) size_t slave_receive(size_t size, size_t address_size, double now_us)
{
    return hn_slave_receive(&slave, io.data, size, io.address, address_size, (int64_t)now_us, io.answer);
}

EXPORT(slavePosition) bool slave_position(void) { return hn_slave_position(&slave, io.numbers); }

EXPORT(slaveAnswer) size_t slave_answer(double now_us)
{
    return hn_slave_answer(&slave, io.numbers, (int64_t)now_us, io.answer);
}

/* `data` has why. */
EXPORT(slaveClose) size_t slave_close(unsigned code)
{
    return hn_slave_close(&slave, (const char *)io.data, code, io.answer);
}

/* Write the address of the session's master to `address`; return its size, or 0 without a session. */
EXPORT(slaveMaster) size_t slave_master(void)
{
    size_t size = 0;
    const void *at = hn_slave_master(&slave, &size);
    if (at == NULL)
        return 0;
    memcpy(io.address, at, size);
    return size;
}

EXPORT(slaveCounts) void slave_counts(void) { io.counts = hn_slave_counts(&slave); }

/* What the suite of peers/conformance reaches behind the header for: the number of a master's next datagram, and a bare
 * decoder. `text` and `numbers` are those of masterInit. */

EXPORT(masterNumber) void master_number(uint32_t sequence) { master.now->sequence = sequence; }

static hn_decoder decoder;

EXPORT(decoderInit) bool decoder_init(unsigned parameters)
{
    hn_request request = read_request(parameters);
    hn_settings s = {.codec = hn_codec_named(hn_text(request.codec)), .axes = request.axes};
    s.weber_fraction = request.weber_fraction;
    s.floor_n = request.floor_n;
    s.multiplier = request.multiplier;
    bool good = s.codec != HN_CODEC_UNKNOWN && hn_law_wrong(&s) == NULL;
    hn_set_defaults(&s);
    for (unsigned i = 0; i < parameters; i++)
        good = hn_set(&s, hn_text(request.parameters[i].name), request.parameters[i].value) == NULL && good;
    hn_decoder_init(&decoder, &s);
    return good;
}

EXPORT(decoderReceive) bool decoder_receive(size_t size, double t_us)
{
    return hn_decode(&decoder, (int64_t)t_us, (hn_bytes){io.data, size});
}

EXPORT(decoderApply) void decoder_apply(double t_us)
{
    hn_vector at;
    memcpy(at, io.numbers, sizeof at);
    if (hn_follows_motion(decoder.settings.codec))
        hn_decoder_move(&decoder, (int64_t)t_us, at);
    hn_decoder_apply(&decoder, (int64_t)t_us, io.numbers);
}
