/* A slave: it serves a spring of 300 N/m behind 20 mm to one master at a time.
 *
 * First: build/slave [PORT]. Then: hapticnet master --connect 127.0.0.1:47800. */
#include <arpa/inet.h>
#include <stdio.h>
#include <sys/random.h>
#include <time.h>

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
    static hn_slave slave;
    int port = 47800, door = socket(AF_INET, SOCK_DGRAM, 0);
    char rest; /* after the number there must be nothing */
    if ((argc > 1 && sscanf(argv[1], "%d%c", &port, &rest) != 1) || port < 1 || port > 65535)
        return fputs("usage: slave [PORT]\n", stderr), 2;
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(door, (struct sockaddr *)&here, sizeof here) != 0)
        return perror("bind"), 2;
    hn_slave_init(&slave, "spring", 1, random32, NULL);

    for (;;) {
        uint8_t data[HN_DATAGRAM_BYTES + 1], answer[HN_DATAGRAM_BYTES];
        struct sockaddr_in from;
        socklen_t length = sizeof from;
        double x_m;
        size_t size = 0, address_size;
        /* Receive all that has arrived, and only then answer the newest position. */
        bool waits = hn_slave_position(&slave, &x_m);
        ssize_t got = recvfrom(door, data, sizeof data, waits ? MSG_DONTWAIT : 0, (struct sockaddr *)&from, &length);
        if (got >= 0) {
            size = hn_slave_receive(&slave, data, (size_t)got, &from, length, now_us(), answer);
            if (size > 0)
                sendto(door, answer, size, 0, (struct sockaddr *)&from, length);
        } else if (waits) {
            double force_n = x_m > 0.02 ? 300.0 * (x_m - 0.02) : 0.0;
            const void *master = hn_slave_master(&slave, &address_size);
            size = hn_slave_answer(&slave, &force_n, now_us(), answer);
            if (size > 0)
                sendto(door, answer, size, 0, master, (socklen_t)address_size);
        }
    }
}
