/* Many masters in one process, for a slave's limits: gcc -O2 -o masters bench/peers/masters.c bench/peers/masters/[a-z]*.c -lcrypto -lm; ./masters --port 47801 --masters 60 --rate 1000 --seconds 5 --codec raw

   Each master has its own address (from 127.1.0.1), so that it is another host to the slave. It asks for a session as
   docs/refer/protocol.md says, and moves a needle in a sine of 0.4 Hz and 35 mm, each at its own phase. Requests are paced
   to what a slave reads. A master sends a few positions a second until all have their sessions; then all send at the
   full rate, evenly spread over the period. It says "measuring" and "measured" on stderr, for another process to read
   the slave's processor time at these moments, and prints its counts of the time between as JSON.

     --codec raw|deadband   what comes back
     --share S              ask for few positions, with this share of the JND, and send lines: position and velocity
     --sends HZ             datagrams a second of each (default: the rate)
     --keys FILE            sealed sessions: three lines of hex with the own private key, the slave's public key, the psk
     --echo                 the peer is an echo, not a slave
     --settle S             seconds at the full rate before it counts (1)
     --asks HZ              requests a second (80)
     --host ADDRESS         IPv4 address of the slave (127.0.0.1) */
#define _GNU_SOURCE
#include "masters/link.h"
#include "masters/session.h"
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>

enum { MOST_MASTERS = 60000, LATE_BINS = 1 << 16, LATE_US = 1000 };

static const double ALIVE_HZ = 4.0; /* positions a second and master before the load begins */
static const uint64_t SAY_AGAIN_NS = 300000000u, LOOK_NS = 20000000u, BEHIND_NS = 20000000u, LINGER_NS = 200000000u;

static struct master *masters;
static unsigned count;
static uint64_t lateness[LATE_BINS]; /* how late positions were sent, in us */
static uint64_t late_sends, unsent;

static void take(unsigned index, uint8_t *data, size_t bytes, uint64_t now)
{
    if (index < count)
        master_take(&masters[index], data, bytes, now);
}

static unsigned in_state(enum state state)
{
    unsigned found = 0;
    for (unsigned i = 0; i < count; i++)
        found += masters[i].state == state;
    return found;
}

/* The positions of all masters in turns: the k-th is due k / (masters * rate) after the start. */
struct turns {
    double spacing_ns;
    uint64_t start_ns, next;
    unsigned cursor;
};

static uint64_t due(const struct turns *turns)
{
    return turns->start_ns + (uint64_t)((double)turns->next * turns->spacing_ns);
}

static struct turns begin_turns(double rate_hz)
{
    return (struct turns){.spacing_ns = 1e9 / (rate_hz * count), .start_ns = now_ns()};
}

/* Send what is due, in at most one batch; return how many turns were taken. */
static unsigned send_due(struct turns *turns, uint64_t now)
{
    unsigned taken = 0;
    while (taken < SENT_AT_ONCE && due(turns) <= now) {
        const uint64_t late_ns = now - due(turns);
        if (late_ns > BEHIND_NS) { /* far behind: this program is the limit, and goes on from the present time */
            const uint64_t skipped = (uint64_t)((double)late_ns / turns->spacing_ns);
            unsent += skipped;
            turns->next += skipped;
            turns->cursor = (unsigned)((turns->cursor + skipped) % count);
        }
        struct master *const master = &masters[turns->cursor];
        if (master->state == ESTABLISHED) {
            const uint64_t late_us = late_ns / 1000;
            lateness[late_us < LATE_BINS ? late_us : LATE_BINS - 1]++;
            late_sends += late_us > LATE_US;
            master_position(master, now);
        }
        turns->cursor = turns->cursor + 1 == count ? 0 : turns->cursor + 1;
        turns->next++;
        taken++;
    }
    link_flush();
    return taken;
}

static void run_until(struct turns *turns, uint64_t end)
{
    for (uint64_t now = now_ns(); now < end; now = now_ns()) {
        const unsigned taken = send_due(turns, now);
        link_read(take);
        if (taken < SENT_AT_ONCE) /* else more is due already */
            link_wait(due(turns) < end ? due(turns) : end);
    }
}

/* Ask for all sessions, `asks_hz` a second, while those that stand send a few positions. */
static void join(double asks_hz)
{
    struct turns alive = begin_turns(ALIVE_HZ);
    const uint64_t start = now_ns(), end = start + (uint64_t)(1e9 * (6.0 + 1.5 * count / asks_hz));
    uint64_t look = start;
    unsigned asked = 0, first = 0;
    for (uint64_t now = start; now < end && first < count; now = now_ns()) {
        while (asked < count && (double)(now - start) * 1e-9 * asks_hz >= asked)
            master_ask(&masters[asked++], now);
        if (now >= look) {
            look = now + LOOK_NS;
            for (unsigned i = first; i < asked; i++)
                if (masters[i].state == ASKING && now - masters[i].said_ns > SAY_AGAIN_NS)
                    master_ask(&masters[i], now);
            while (first < asked && masters[first].state != ASKING)
                first++;
        }
        link_flush();
        send_due(&alive, now);
        link_read(take);
        link_wait(due(&alive) < look ? due(&alive) : look);
    }
}

static void part(void)
{
    for (int tries = 0; tries < 3 && in_state(ESTABLISHED) + in_state(CLOSING); tries++) {
        for (unsigned i = 0; i < count; i++)
            if (masters[i].state == ESTABLISHED || masters[i].state == CLOSING) {
                master_close(&masters[i]);
                if (i % SENT_AT_ONCE == 0) { /* not all at once: a slave's queue is short */
                    link_flush();
                    link_wait(now_ns() + 2000000u);
                    link_read(take);
                }
            }
        link_flush();
        for (uint64_t end = now_ns() + LINGER_NS; now_ns() < end && in_state(CLOSING);) {
            link_wait(end);
            link_read(take);
        }
    }
}

static double percentile(const uint64_t *bins, int size, double share)
{
    uint64_t total = 0, seen = 0;
    for (int i = 0; i < size; i++)
        total += bins[i];
    for (int i = 0; i < size; i++)
        if ((seen += bins[i]) && (double)seen >= share * (double)total)
            return i;
    return -1.0;
}

static double cpu_s(void)
{
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    return (double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec)
           + 1e-6 * (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
}

static void measure(double sends_hz, double settle_s, double seconds)
{
    static struct counts seen; /* what closing adds is not part of the time measured */
    struct turns turns = begin_turns(sends_hz);
    run_until(&turns, now_ns() + (uint64_t)(1e9 * settle_s));
    const unsigned at_work = in_state(ESTABLISHED);
    const uint64_t refused_before = counts.refused, sends_refused = link_refused(), ended_before = counts.ended;
    const uint32_t drops = link_drops();
    memset(&counts, 0, sizeof counts);
    memset(lateness, 0, sizeof lateness);
    late_sends = unsent = 0;
    const uint64_t start = now_ns();
    counted_from_us = (uint32_t)(start / 1000);
    const double cpu = cpu_s();
    fprintf(stderr, "measuring\n");
    run_until(&turns, start + (uint64_t)(1e9 * seconds));
    const double took_s = 1e-9 * (double)(now_ns() - start), used_s = cpu_s() - cpu;
    fprintf(stderr, "measured\n");
    for (uint64_t end = now_ns() + LINGER_NS; now_ns() < end;) {
        link_wait(end);
        link_read(take);
    }
    seen = counts;
    counts.closed = 0;
    if (!wanted.echoed)
        part();
    printf("{\"masters\": %u, \"at_work\": %u, \"refused\": %lu, \"ended_before\": %lu, \"ended\": %lu, \"resets\": %lu,\n",
           count, at_work, refused_before, ended_before, seen.ended, seen.resets);
    printf(" \"closed\": %lu, \"seconds\": %.6f, \"positions\": %lu, \"unsent\": %lu, \"late_sends\": %lu,\n", counts.closed,
           took_s, seen.positions, unsent, late_sends);
    printf(" \"late_p50_us\": %.0f, \"late_p99_us\": %.0f, \"answers\": %lu, \"forces\": %lu, \"keepalives\": %lu,\n",
           percentile(lateness, LATE_BINS, 0.5), percentile(lateness, LATE_BINS, 0.99), seen.answers, seen.forces,
           seen.keepalives);
    printf(" \"lost\": %lu, \"late\": %lu, \"malformed\": %lu, \"sends_refused\": %lu, \"kernel_drops\": %u,\n", seen.lost,
           seen.late, seen.malformed, link_refused() - sends_refused, link_drops() - drops);
    printf(" \"sent_bytes\": %lu, \"received\": %lu, \"received_bytes\": %lu, \"greatest_force_n\": %.6f,\n", seen.sent_bytes,
           seen.received, seen.received_bytes, seen.greatest_n);
    printf(" \"generator_cpu_s\": %.6f, \"trip_p50_us\": %.0f, \"trip_p99_us\": %.0f, \"trip_p99_9_us\": %.0f,\n", used_s,
           percentile(seen.trips, TRIP_BINS, 0.5), percentile(seen.trips, TRIP_BINS, 0.99),
           percentile(seen.trips, TRIP_BINS, 0.999));
    printf(" \"trip_worst_us\": %.0f}\n", percentile(seen.trips, TRIP_BINS, 1.0));
}

int main(int argc, char **argv)
{
    static const struct option options[] = {
        {"port", 1, NULL, 'p'}, {"masters", 1, NULL, 'n'}, {"rate", 1, NULL, 'r'}, {"seconds", 1, NULL, 's'},
        {"codec", 1, NULL, 'c'}, {"share", 1, NULL, 'S'}, {"sends", 1, NULL, 'f'}, {"keys", 1, NULL, 'k'},
        {"settle", 1, NULL, 'w'}, {"asks", 1, NULL, 'a'}, {"host", 1, NULL, 'h'}, {"echo", 0, NULL, 'e'}, {NULL, 0, NULL, 0},
    };
    const char *host = "127.0.0.1";
    double seconds = 5.0, settle_s = 1.0, asks_hz = 80.0, sends_hz = 0.0;
    int port = 0, option;
    wanted = (struct wanted){.codec = "raw", .rate_hz = 1000.0};
    while ((option = getopt_long(argc, argv, "", options, NULL)) != -1)
        switch (option) {
        case 'p': port = atoi(optarg); break;
        case 'n': count = (unsigned)atoi(optarg); break;
        case 'r': wanted.rate_hz = atof(optarg); break;
        case 's': seconds = atof(optarg); break;
        case 'c': wanted.codec = optarg; break;
        case 'S': wanted.share = atof(optarg); break;
        case 'f': sends_hz = atof(optarg); break;
        case 'w': settle_s = atof(optarg); break;
        case 'a': asks_hz = atof(optarg); break;
        case 'h': host = optarg; break;
        case 'e': wanted.echoed = 1; break;
        case 'k':
            wanted.sealed = 1;
            if (!seal_load_keys(optarg)) break;
            fprintf(stderr, "masters: %s does not hold three keys in hex\n", optarg);
            return 2;
        default: return 2;
        }
    if (sends_hz <= 0.0)
        sends_hz = wanted.rate_hz;
    if (port < 1 || port > 65535 || count < 1 || count > MOST_MASTERS || !(wanted.rate_hz > 0.0) || !(seconds > 0.0)
        || (strcmp(wanted.codec, "raw") && strcmp(wanted.codec, "deadband")) || optind != argc || !(asks_hz > 0.0)) {
        fprintf(stderr, "masters: --port, --masters (1 to %d), --rate and --seconds above 0, --codec raw or deadband\n",
                MOST_MASTERS);
        return 2;
    }
    masters = calloc(count, sizeof *masters);
    if (!masters || link_open(host, port)) {
        perror("masters");
        return 1;
    }
    prctl(PR_SET_TIMERSLACK, 1);
    for (unsigned i = 0; i < count; i++) {
        masters[i].index = i;
        masters[i].phase = 6.283185307179586 * fmod(0.618033988749895 * i, 1.0); /* the golden ratio spreads them */
        if (wanted.echoed) {
            masters[i].state = ESTABLISHED;
            masters[i].session = (1u << 16) + i;
            masters[i].sequence = 1u << 16; /* as long as in a session that has lasted a minute */
        }
    }
    if (!wanted.echoed)
        join(asks_hz);
    measure(sends_hz, settle_s, seconds);
    return 0;
}
