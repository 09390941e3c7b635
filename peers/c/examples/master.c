/* A master that moves in and out of a scene for some seconds, and prints what a hand would feel.
 *
 * First: hapticnet slave --scene paper. Then: build/master [IPv4-ADDRESS [PORT [SECONDS]]]. */
#include <arpa/inet.h>
#include <math.h>
#include <stdio.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

#include "hapticnet.h"

static int64_t now_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000;
}

static uint32_t random32(void *context)
{
    uint32_t bits;
    (void)context, (void)!getrandom(&bits, sizeof bits, 0);
    return bits;
}

int main(int argc, char **argv)
{
    static hn_master master;
    const hn_request request = {.codec = "deadband", .name = "C", .weber_fraction = 0.05, .floor_n = 0.025,
                                .multiplier = 1.0, .rate_hz = 1000.0, .axes = 1};
    double force_n[1], seconds = 5.0;
    int port = 47800, link = socket(AF_INET, SOCK_DGRAM, 0);
    char rest; /* after a number there must be nothing */
    bool good = (argc < 3 || sscanf(argv[2], "%d%c", &port, &rest) == 1) && 1 <= port && port <= 65535 &&
                (argc < 4 || sscanf(argv[3], "%lf%c", &seconds, &rest) == 1) && 0.0 < seconds && seconds <= 1e6;
    struct sockaddr_in slave = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    if (!good || inet_pton(AF_INET, argc > 1 ? argv[1] : "127.0.0.1", &slave.sin_addr) != 1 ||
        connect(link, (struct sockaddr *)&slave, sizeof slave) != 0 ||
        hn_master_init(&master, &request, random32, NULL) != NULL)
        return fputs("usage: master [IPv4-ADDRESS [PORT [SECONDS]]]\n", stderr), 2;
    uint8_t data[HN_DATAGRAM_BYTES + 1]; /* a byte more, so that a longer datagram is seen to be one */
    for (int64_t tick = 0, due_us = now_us(); hn_master_state(&master) != HN_CLOSED; tick++, due_us += 1000) {
        double x_m = 0.015 * (1.0 - cos(6.283185307e-3 * (double)tick / seconds));
        if (tick == (int64_t)(seconds * 1e3))
            hn_master_close(&master, "done", now_us());
        hn_master_tick(&master, &x_m, now_us());
        hn_master_force(&master, force_n, now_us());
        if (tick % 100 == 0)
            printf("%6.2f mm  %6.2f N%s\n", x_m * 1e3, force_n[0],
                   hn_master_state(&master) == HN_ESTABLISHED ? "" : "  no session with the slave");
        do {
            for (size_t size; (size = hn_master_send(&master, data)) > 0;)
                send(link, data, size, MSG_DONTWAIT);
            ssize_t got = recv(link, data, sizeof data, MSG_DONTWAIT);
            got > 0 ? hn_master_receive(&master, data, (size_t)got, now_us()) : (void)usleep(50);
        } while (now_us() < due_us + 1000);
    }
    return 0;
}
