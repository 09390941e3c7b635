/* The library as a peer of the conformance suite: reads commands, writes answers (../../conformance/README.md). */
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "decoder.h"
#include "hapticnet_sealed.h"
#include "messages.h"

enum { LINE = 1 << 14, FIELDS = 64, MOST_MASTERS = 8, ANY = 0, MASTER = 1, SLAVE = 2 };

static char line[LINE + 2], reply[2 * LINE], *fields[FIELDS], texts[8][LINE / 8];
static unsigned count, role, axes; /* count of fields, without the command */
static size_t said, size, word, word_count;
static jmp_buf failed;
static const char *why;

static hn_master master;
static hn_slave slave;
static hn_decoder decoder;
static hn_master_keys master_keys;
static hn_slave_keys slave_keys;
static hn_listed listed[MOST_MASTERS];
static hn_vector vector;
static int64_t now_us;
static uint32_t words[LINE / 8]; /* what the library draws */
static uint8_t data[LINE], datagram[HN_DATAGRAM_BYTES];

static void fail(const char *reason)
{
    why = reason;
    longjmp(failed, 1);
}

static uint32_t draw(void *context)
{
    (void)context;
    return words[word + 1 < word_count ? word++ : word];
}

/* Read fields */

static size_t hex(const char *digits, void *out, size_t room)
{
    size_t length = strcmp(digits, "-") == 0 ? 0 : strlen(digits);
    if (length % 2 != 0 || length / 2 > room || strspn(digits, "0123456789abcdef") < length)
        fail("these are not the hex digits that are expected here");
    for (size_t i = 0; i < length; i += 2) {
        char pair[3] = {digits[i], digits[i + 1], '\0'};
        ((uint8_t *)out)[i / 2] = (uint8_t)strtoul(pair, NULL, 16);
    }
    return length / 2;
}

static void key(const char *digits, uint8_t *out)
{
    if (hex(digits, out, 32) != 32)
        fail("a key has 32 bytes");
}

static const char *text(const char *digits, unsigned i)
{
    texts[i][hex(digits, texts[i], sizeof texts[i] - 1)] = '\0';
    return texts[i];
}

static int64_t integer(const char *digits)
{
    char *end;
    int64_t value = strtoll(digits, &end, 10);
    if (*digits == '\0' || *end != '\0')
        fail("this is no integer");
    return value;
}

static double number(const char *digits)
{
    uint8_t bytes[8];
    if (hex(digits, bytes, 8) != 8)
        fail("a float has 16 hex digits");
    return hn_read_double(bytes);
}

static void read_vector(void)
{
    if (count != 1 + axes)
        fail("a float for each axis is needed");
    for (unsigned i = 0; i < axes; i++)
        vector[i] = number(fields[1 + i]);
}

/* Answer */

static void say(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    said += (size_t)vsnprintf(reply + said, sizeof reply - said, format, values);
    va_end(values);
}

static void say_hex(const void *bytes, size_t length)
{
    say(length > 0 ? " " : " -");
    for (size_t i = 0; i < length; i++)
        say("%02x", ((const uint8_t *)bytes)[i]);
}

static void say_vector(void)
{
    for (unsigned i = 0; i < axes; i++) {
        uint8_t bytes[8];
        hn_store_double(bytes, vector[i]);
        say_hex(bytes, 8);
    }
}

/* Make nodes */

static void set(hn_request *r, const char *name, const char *value)
{
    unsigned i = 0;
    if (strcmp(name, "codec") == 0)
        r->codec = strcpy(texts[0], value);
    else if (strcmp(name, "name") == 0 || strcmp(name, "scene") == 0)
        r->name = text(value, 1);
    else if (strcmp(name, "axes") == 0)
        r->axes = (unsigned)integer(value);
    else if (strcmp(name, "rate") == 0)
        r->rate_hz = number(value);
    else if (strcmp(name, "weber") == 0)
        r->weber_fraction = number(value);
    else if (strcmp(name, "floor") == 0)
        r->floor_n = number(value);
    else if (strcmp(name, "multiplier") == 0)
        r->multiplier = number(value);
    else if (strcmp(name, "share") == 0)
        r->position_share = number(value);
    else if (strcmp(name, "announced") == 0)
        r->announced = strcmp(value, "1") == 0;
    else if (strcmp(name, "predicted") == 0)
        r->predicted = strcmp(value, "1") == 0;
    else if (strncmp(name, "p.", 2) == 0) {
        while (i < HN_MOST_PARAMETERS && r->parameters[i].name != NULL)
            i++;
        if (i == HN_MOST_PARAMETERS)
            fail("there are too many parameters");
        r->parameters[i].name = strcpy(texts[2 + i], name + 2);
        r->parameters[i].value = number(value);
    } else
        fail("a key is unknown");
}

static hn_request request(void)
{
    hn_request r = {.codec = "", .name = ""};
    for (unsigned i = 0; i < count; i++) {
        char *value = strchr(fields[i], '=');
        if (value == NULL || strlen(value) >= sizeof texts[0])
            fail("a field is not KEY=VALUE");
        *value = '\0';
        set(&r, fields[i], value + 1);
    }
    if (r.axes < 1 || r.axes > HN_MOST_AXES)
        fail("axes are 1 to 3");
    role = ANY;
    axes = r.axes;
    return r;
}

static void make_master(void)
{
    static double memory[1 << 17]; /* of three axes at 3 kHz, with all that takes memory */
    hn_request r = request();
    if (hn_more_bytes(&r) > sizeof memory)
        fail("there is too little memory");
    if (hn_more_bytes(&r) > 0)
        r.more = hn_more_init(memory, &r);
    const char *wrong = hn_master_init(&master, &r, draw, NULL);
    if (wrong != NULL)
        fail(wrong);
    role = MASTER;
}

static void make_slave(void)
{
    hn_request r = request();
    hn_slave_init(&slave, r.name, r.axes, draw, NULL);
    role = SLAVE;
}

static void make_decoder(void)
{
    hn_request r = request();
    hn_settings s = {hn_codec_named(hn_text(r.codec)), r.axes, {0}, r.weber_fraction, r.floor_n, r.multiplier};
    bool good = s.codec != HN_CODEC_UNKNOWN && hn_law_wrong(&s) == NULL;
    hn_set_defaults(&s);
    for (unsigned i = 0; i < HN_MOST_PARAMETERS && r.parameters[i].name != NULL; i++)
        good = good && hn_set(&s, hn_text(r.parameters[i].name), r.parameters[i].value) == NULL;
    if (!good)
        fail("there is no such decoder");
    hn_decoder_init(&decoder, &s);
}

static void seal(void)
{
    hn_key own;
    memset(listed, 0, sizeof listed);
    if (count % 2 == 0 || count / 2 > MOST_MASTERS)
        fail("a seal is an own key, and pairs of a key and a shared one");
    key(fields[0], own);
    for (unsigned i = 0; i < count / 2; i++) {
        key(fields[2 * i + 1], listed[i].public_key);
        if (strcmp(fields[2 * i + 2], "-") != 0)
            key(fields[2 * i + 2], listed[i].psk);
    }
    if (role == ANY || (role == MASTER && hn_master_seal(&master, &master_keys, own, listed[0].public_key,
                                                          strcmp(fields[2], "-") == 0 ? NULL : listed[0].psk) != NULL))
        fail("the key is of low order, or there is no node");
    if (role == SLAVE && hn_slave_seal(&slave, &slave_keys, own, listed, count / 2) != NULL)
        fail("the keys are refused");
}

/* Commands */

static void say_features(void)
{
    say(" language=C roles=master,slave sealed=master,slave axes=3 slave_codecs=raw,deadband also=sequence,decoder,"
        "share,announced,predicted codecs=raw,deadband,adaptive-predictive,linear-predictive,least-squares,"
        "level-crossing,probabilistic,merging,velocity-adaptive,motion-predictive,passive-extrapolative,"
        "passive-interpolative,model-mediated");
}

static void set_random(void)
{
    word = 0;
    word_count = hex(fields[0], data, sizeof data) / 4;
    for (size_t i = 0; i < word_count; i++)
        words[i] = (uint32_t)data[4 * i] << 24 | (uint32_t)data[4 * i + 1] << 16 | (uint32_t)data[4 * i + 2] << 8 |
                   data[4 * i + 3];
}

static void tick(void)
{
    read_vector();
    hn_master_tick(&master, vector, now_us);
}

static void force(void)
{
    hn_master_force(&master, vector, now_us);
    say_vector();
}

static void send_all(void)
{
    while ((size = hn_master_send(&master, datagram)) > 0)
        say_hex(datagram, size);
}

static void receive(void)
{
    size = hex(fields[1], data, sizeof data);
    hn_master_receive(&master, data, size, now_us);
}

static void close_master(void)
{
    hn_master_close(&master, text(fields[1], 7), now_us);
}

static void say_state(void)
{
    static const char *const states[] = {"connecting", "established", "stale", "closing", "closed"};
    say(" %s", states[hn_master_state(&master)]);
}

static void say_reason(void)
{
    unsigned code;
    const char *reason = hn_master_reason(&master, &code);
    say(" %u", code);
    say_hex(reason, strlen(reason));
}

static void say_scene(void)
{
    say_hex(hn_master_scene(&master), strlen(hn_master_scene(&master)));
}

static void say_counts(void)
{
    hn_counts c = role == MASTER ? hn_master_counts(&master) : hn_slave_counts(&slave);
    say(" %" PRIu32 " %" PRIu32 " %" PRIu32, c.malformed, c.stray, c.too_old);
}

static void set_sequence(void)
{
    master.now->sequence = (uint32_t)integer(fields[0]);
}

static void serve(void)
{
    uint8_t address[HN_ADDRESS_BYTES];
    size_t address_size = hex(fields[2], address, sizeof address);
    size = hex(fields[1], data, sizeof data);
    say_hex(datagram, hn_slave_receive(&slave, data, size, address, address_size, now_us, datagram));
}

static void say_position(void)
{
    if (hn_slave_position(&slave, vector))
        say_vector();
    else
        say(" -");
}

static void answer(void)
{
    read_vector();
    say_hex(datagram, hn_slave_answer(&slave, vector, now_us, datagram));
}

static void close_slave(void)
{
    int64_t code = integer(fields[0]);
    say_hex(datagram, hn_slave_close(&slave, text(fields[1], 7), (unsigned)code, datagram));
}

static void say_address(void)
{
    const void *address = hn_slave_master(&slave, &size);
    say_hex(address, address == NULL ? 0 : size);
}

static void decode(void)
{
    size = hex(fields[1], data, sizeof data);
    say(hn_decode(&decoder, now_us, (hn_bytes){data, size}) ? " 1" : " 0");
}

static void apply(void)
{
    read_vector();
    if (hn_follows_motion(decoder.settings.codec))
        hn_decoder_move(&decoder, now_us, vector);
    hn_decoder_apply(&decoder, now_us, vector);
    say_vector();
}

static const struct {
    const char *name;
    unsigned role, least; /* fields that it needs */
    bool has_time;        /* as its first field */
    void (*call)(void);
} commands[] = {
    {"features", ANY, 0, false, say_features}, {"random", ANY, 1, false, set_random},
    {"master", ANY, 1, false, make_master},    {"slave", ANY, 1, false, make_slave},
    {"decoder", ANY, 1, false, make_decoder},  {"seal", ANY, 3, false, seal},
    {"tick", MASTER, 2, true, tick},           {"force", MASTER, 1, true, force},
    {"send", MASTER, 0, false, send_all},      {"receive", MASTER, 2, true, receive},
    {"close", MASTER, 2, true, close_master},  {"state", MASTER, 0, false, say_state},
    {"reason", MASTER, 0, false, say_reason},  {"scene", MASTER, 0, false, say_scene},
    {"counts", MASTER, 0, false, say_counts},  {"counts", SLAVE, 0, false, say_counts},
    {"receive", SLAVE, 3, true, serve},        {"position", SLAVE, 0, false, say_position},
    {"answer", SLAVE, 2, true, answer},        {"close", SLAVE, 2, false, close_slave},
    {"address", SLAVE, 0, false, say_address}, {"sequence", MASTER, 1, false, set_sequence},
    {"decode", ANY, 2, true, decode},          {"apply", ANY, 2, true, apply},
};

static void obey(const char *name)
{
    for (unsigned i = 0; i < sizeof commands / sizeof *commands; i++) {
        if (strcmp(commands[i].name, name) != 0 || (commands[i].role != ANY && commands[i].role != role))
            continue;
        if (count < commands[i].least)
            fail("a field is missing");
        if (commands[i].has_time)
            now_us = integer(fields[0]);
        commands[i].call();
        return;
    }
    fail("there is no such command, or no node for it");
}

int main(void)
{
    while (fgets(line, sizeof line, stdin) != NULL) {
        said = count = 0;
        reply[0] = '\0';
        if (setjmp(failed) == 0) {
            char *name = strtok(line, " \n"), *each;
            while ((each = strtok(NULL, " \n")) != NULL && count < FIELDS)
                fields[count++] = each;
            obey(name == NULL ? "" : name);
            printf("ok%s\n", reply);
        } else {
            printf("error %s\n", why);
        }
        fflush(stdout);
    }
    return 0;
}
