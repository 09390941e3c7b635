/* Send datagrams to an IPv4 address at a constant rate, each from another source address and port.

   flood HOST PORT RATE SECONDS FIRST_OCTET < DATAGRAMS

   DATAGRAMS are sent in turns; each is its length, two bytes with the most significant first, and its bytes. A source
   is FIRST_OCTET.x.y.z with random x, y and z, and one of PORTS ports. The system must own all these addresses: it does
   for 127, and for others after `ip route add local FIRST_OCTET.0.0.0/8 dev lo`. Answers are not read.

   Prints a line when it begins, and how many datagrams were sent, in how many seconds, when it ends. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>

enum { PORTS = 64, LARGEST = 1500, MOST_DATAGRAMS = 1 << 16 };

struct datagram {
    size_t length;
    unsigned char bytes[LARGEST];
};

static uint64_t state = 88172645463325252u;

/* Marsaglia's xorshift64: no secret, only different addresses. */
static uint64_t random_bits(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static size_t read_datagrams(struct datagram *to)
{
    size_t count = 0;
    int high, low;
    while (count < MOST_DATAGRAMS && (high = getchar()) != EOF && (low = getchar()) != EOF) {
        const size_t length = (size_t)high << 8 | (size_t)low;
        if (length > LARGEST || fread(to[count].bytes, 1, length, stdin) != length)
            break;
        to[count++].length = length;
    }
    return count;
}

static int open_socket(void)
{
    const int least = 1;
    const int sock = socket(AF_INET, SOCK_DGRAM, 0);
    const struct sockaddr_in any = {.sin_family = AF_INET};
    if (sock < 0 || bind(sock, (const struct sockaddr *)&any, sizeof any))
        return -1;
    setsockopt(sock, SOL_SOCKET, SO_RCVBUF, &least, sizeof least);
    return sock;
}

static int send_from(int sock, uint32_t source, const struct sockaddr_in *to, struct datagram *datagram)
{
    union {
        struct cmsghdr align;
        char room[CMSG_SPACE(sizeof(struct in_pktinfo))];
    } control;
    struct iovec part = {.iov_base = datagram->bytes, .iov_len = datagram->length};
    struct msghdr message = {
        .msg_name = (void *)to, .msg_namelen = sizeof *to, .msg_iov = &part, .msg_iovlen = 1,
        .msg_control = control.room, .msg_controllen = sizeof control.room,
    };
    struct cmsghdr *const head = CMSG_FIRSTHDR(&message);
    head->cmsg_level = IPPROTO_IP;
    head->cmsg_type = IP_PKTINFO;
    head->cmsg_len = CMSG_LEN(sizeof(struct in_pktinfo));
    const struct in_pktinfo from = {.ipi_spec_dst.s_addr = htonl(source)};
    memcpy(CMSG_DATA(head), &from, sizeof from);
    return sendmsg(sock, &message, MSG_DONTWAIT) < 0 ? -1 : 0;
}

static double seconds_since(const struct timespec *start)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)(now.tv_sec - start->tv_sec) + (double)(now.tv_nsec - start->tv_nsec) * 1e-9;
}

int main(int argc, char **argv)
{
    if (argc != 6) {
        fprintf(stderr, "usage: flood HOST PORT RATE SECONDS FIRST_OCTET < DATAGRAMS\n");
        return 2;
    }
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(argv[2]))};
    const double rate = atof(argv[3]), seconds = atof(argv[4]);
    const uint32_t first_octet = (uint32_t)atoi(argv[5]) << 24;
    struct datagram *const datagrams = calloc(MOST_DATAGRAMS, sizeof *datagrams);
    const size_t count = datagrams ? read_datagrams(datagrams) : 0;
    if (inet_pton(AF_INET, argv[1], &to.sin_addr) != 1 || rate <= 0.0 || !count) {
        fprintf(stderr, "flood: bad address, rate or datagrams\n");
        return 2;
    }
    int sockets[PORTS];
    for (int i = 0; i < PORTS; i++)
        if ((sockets[i] = open_socket()) < 0) {
            perror("flood");
            return 1;
        }
    prctl(PR_SET_TIMERSLACK, 1);
    struct timespec start;
    clock_gettime(CLOCK_MONOTONIC, &start);
    printf("started\n");
    fflush(stdout);
    long sent = 0, failed = 0;
    for (long i = 0; seconds_since(&start) < seconds; i++) {
        const double due_s = (double)i / rate;
        struct timespec due = start;
        due.tv_sec += (time_t)due_s;
        due.tv_nsec += (long)((due_s - (double)(time_t)due_s) * 1e9);
        if (due.tv_nsec >= 1000000000) {
            due.tv_nsec -= 1000000000;
            due.tv_sec++;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        const uint64_t bits = random_bits();
        /* The last octet is 1 to 254: neither a network nor a broadcast address. */
        const uint32_t host = (uint32_t)(bits >> 16 & 0xffff00) | (uint32_t)(1 + (bits >> 40) % 254);
        if (send_from(sockets[bits % PORTS], first_octet | host, &to, &datagrams[(size_t)i % count]))
            failed++;
        else
            sent++;
    }
    printf("%ld sent, %ld failed, %.3f s\n", sent, failed, seconds_since(&start));
    free(datagrams);
    return 0;
}
