/* Both ends in one program, joined by a network that loses, delays and reorders, in virtual time.
 *
 *     both [MILLISECONDS [DAMAGED]]
 *
 * It prints a checksum of all forces that the master applied: the same on every machine. With DAMAGED, so many changed
 * copies of each datagram arrive as well, the ends are closed and started again at times, and random payloads go to the
 * decoders of every codec. Most masters then ask for more than the slave has, and get it (tests/granting.h). The
 * checksum then says nothing, and the sanitizers that it is built with do. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "decoder.h"
#include "granting.h"

enum { WAITING = 64 };

typedef struct {
    uint8_t data[HN_DATAGRAM_BYTES + 1];
    size_t size;
    int64_t due_us;
} packet;

static packet to_slave[WAITING], to_master[WAITING];
static hn_master master;
static hn_slave slave;
static hn_decoder decoder;
static uint64_t seed = 88172645463325252u, arrived;
static unsigned damaged;

static uint32_t random32(void *context)
{
    (void)context;
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (uint32_t)(seed >> 32);
}

unsigned below(unsigned limit)
{
    return random32(NULL) % limit;
}

static void check(bool good, const char *what)
{
    if (!good) {
        fprintf(stderr, "wrong: %s\n", what);
        abort();
    }
}

/* Send a datagram: one in ten is lost, the others take 5 to 25 ms. */
static void post(packet *link, const uint8_t *data, size_t size, int64_t now_us)
{
    packet *free_one = &link[below(WAITING)];
    check(size <= HN_DATAGRAM_BYTES, "a datagram is too large");
    if (size == 0 || below(10) == 0)
        return;
    memcpy(free_one->data, data, size);
    free_one->size = size;
    free_one->due_us = now_us + 5000 + below(20000);
}

static void answer_position(int64_t now_us)
{
    uint8_t answer[HN_DATAGRAM_BYTES];
    hn_vector position_m, force_n;
    if (!hn_slave_position(&slave, position_m))
        return;
    for (unsigned i = 0; i < 2; i++)
        force_n[i] = position_m[i] > 0.01 ? 300.0 * (position_m[i] - 0.01) : 0.0;
    post(to_master, answer, hn_slave_answer(&slave, force_n, now_us, answer), now_us);
}

static void arrive(bool at_slave, const uint8_t *data, size_t size, int64_t now_us)
{
    uint8_t answer[HN_DATAGRAM_BYTES];
    arrived++;
    if (!at_slave) {
        hn_master_receive(&master, data, size, now_us);
        return;
    }
    post(to_master, answer, hn_slave_receive(&slave, data, size, "here", 4, now_us, answer), now_us);
    answer_position(now_us);
}

/* Change some bytes or bits, cut the end off, or repeat a piece. */
static size_t damage(uint8_t *data, size_t size)
{
    for (unsigned left = 1 + below(4); left > 0 && size > 0; left--) {
        unsigned at = below((unsigned)size), length = below((unsigned)size - at) + 1;
        switch (below(5)) {
        case 0:
            data[at] = (uint8_t)random32(NULL);
            break;
        case 1:
            data[at] ^= (uint8_t)(1u << below(8));
            break;
        case 2: /* a head of msgpack */
            data[at] = (uint8_t)(0x80 + below(0x80));
            break;
        case 3:
            size = at;
            break;
        default:
            if (size + length <= HN_DATAGRAM_BYTES + 1) {
                memmove(data + at + length, data + at, size - at);
                size += length;
            }
        }
    }
    return size;
}

/* Give random payloads to the decoder of some codec. */
static void decode_anything(int64_t now_us)
{
    static hn_settings settings;
    uint8_t payload[64];
    hn_vector stimulus_n, position_m = {0.01 * below(3), 0.02, 0.0};
    if (below(100) == 0 || settings.axes == 0) {
        settings = (hn_settings){(int)below(HN_CODEC_UNKNOWN), 1 + below(3), {0}, 0.05, 0.025, 1.0};
        hn_set_defaults(&settings);
        hn_decoder_init(&decoder, &settings);
    }
    size_t size = below(sizeof payload);
    for (size_t i = 0; i < size; i++)
        payload[i] = below(3) ? (uint8_t)random32(NULL) : (uint8_t)below(4);
    hn_decode(&decoder, now_us - below(100000), (hn_bytes){payload, size});
    hn_decoder_move(&decoder, now_us, position_m);
    hn_decoder_apply(&decoder, now_us, stimulus_n);
    for (unsigned i = 0; i < settings.axes; i++)
        check(fabs(stimulus_n[i]) <= 2e15, "a stimulus is not finite");
}

static void deliver(packet *link, bool at_slave, int64_t now_us)
{
    uint8_t data[HN_DATAGRAM_BYTES + 1];
    for (packet *each = link; each < link + WAITING; each++) {
        if (each->size == 0 || each->due_us > now_us)
            continue;
        /* Before the damage: a copy whose request is whole would be refused, and the master closed. */
        size_t size = at_slave ? without_more(each->data, each->size) : with_more(each->data, each->size);
        each->size = 0;
        for (unsigned i = 0; i < damaged; i++) {
            memcpy(data, each->data, size);
            arrive(below(8) ? at_slave : !at_slave, data, damage(data, size), now_us);
            decode_anything(now_us);
        }
        memcpy(data, each->data, size);
        arrive(at_slave, data, size, now_us);
    }
}

static void start_master(void)
{
    hn_request request = {.codec = "deadband", .name = "both", .parameters = {{"step_n", 0.001}},
                          .weber_fraction = 0.05, .floor_n = 0.025, .multiplier = 1.0, .rate_hz = 1000.0, .axes = 2};
    if (damaged > 0)
        ask_for_more(&request);
    check(hn_master_init(&master, &request, random32, NULL) == NULL, "the request is refused");
}

int main(int argc, char **argv)
{
    long milliseconds = argc > 1 ? atol(argv[1]) : 3000;
    uint64_t checksum = 14695981039346656037u;
    double greatest_n = 0.0;
    uint8_t data[HN_DATAGRAM_BYTES];
    damaged = argc > 2 ? (unsigned)atol(argv[2]) : 0;
    start_master();
    hn_slave_init(&slave, "two springs", 2, random32, NULL);
    for (long tick = 0; tick < milliseconds; tick++) {
        int64_t now_us = 4294000000 + 1000 * (int64_t)tick;
        double phase = 1e-3 * (double)(tick % 2000), in = phase < 1.0 ? phase : 2.0 - phase;
        hn_vector position_m = {0.03 * in, 0.02 * in}, force_n;
        if (damaged > 0 && below(1000) == 0)
            hn_master_close(&master, "enough", now_us);
        if (damaged > 0 && below(1000) == 0)
            hn_slave_init(&slave, "two springs", 2, random32, NULL);
        if (hn_master_state(&master) == HN_CLOSED)
            start_master();
        hn_master_tick(&master, position_m, now_us);
        hn_master_force(&master, force_n, now_us);
        for (size_t size; (size = hn_master_send(&master, data)) > 0;)
            post(to_slave, data, size, now_us);
        deliver(to_slave, true, now_us);
        deliver(to_master, false, now_us);
        for (unsigned i = 0; i < 2; i++) {
            uint64_t bits;
            memcpy(&bits, &force_n[i], sizeof bits);
            checksum = (checksum ^ bits) * 1099511628211u;
            greatest_n = fmax(greatest_n, fabs(force_n[i]));
            check(fabs(force_n[i]) <= HN_LARGEST_COMPONENT, "a force is not finite");
        }
    }
    /* whole millinewtons: the small printf of a microcontroller has no %f */
    printf("%lu datagrams, forces up to %lu mN (checksum %08lx%08lx), state of a master %lu bytes, of a slave %lu bytes\n",
           (unsigned long)arrived, (unsigned long)(1000.0 * greatest_n), (unsigned long)(checksum >> 32),
           (unsigned long)(checksum & 0xffffffff), (unsigned long)sizeof master, (unsigned long)sizeof slave);
    return 0;
}
