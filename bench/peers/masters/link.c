/* See link.h. */
#define _GNU_SOURCE
#include "link.h"
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { BUFFER_BYTES = 8 << 20, SHORTEST_SLEEP_NS = 20000 };

/* Master 0 is 127.1.0.1. */
static const uint32_t FIRST_HOST = 127u << 24 | 1u << 16 | 1u;

union control {
    struct cmsghdr align;
    char room[CMSG_SPACE(sizeof(struct in_pktinfo)) + CMSG_SPACE(sizeof(uint32_t))];
};

static int sock = -1;
static struct sockaddr_in peer;
static struct mmsghdr out[SENT_AT_ONCE], in[READ_AT_ONCE];
static struct iovec out_parts[SENT_AT_ONCE], in_parts[READ_AT_ONCE];
static union control out_control[SENT_AT_ONCE], in_control[READ_AT_ONCE];
static uint8_t out_bytes[SENT_AT_ONCE][MOST_BYTES], in_bytes[READ_AT_ONCE][MOST_BYTES + 1];
static unsigned waiting;
static uint32_t drops;
static uint64_t refused;

uint64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

int link_open(const char *host, int port)
{
    const int yes = 1, size = BUFFER_BYTES;
    const struct sockaddr_in any = {.sin_family = AF_INET};
    peer = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    if (inet_pton(AF_INET, host, &peer.sin_addr) != 1) {
        errno = EINVAL;
        return -1;
    }
    sock = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    if (sock < 0 || bind(sock, (const struct sockaddr *)&any, sizeof any)
        || setsockopt(sock, IPPROTO_IP, IP_PKTINFO, &yes, sizeof yes)
        || setsockopt(sock, SOL_SOCKET, SO_RXQ_OVFL, &yes, sizeof yes))
        return -1;
    if (setsockopt(sock, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof size))
        setsockopt(sock, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    for (unsigned i = 0; i < SENT_AT_ONCE; i++) {
        out_parts[i].iov_base = out_bytes[i];
        out[i].msg_hdr = (struct msghdr){
            .msg_name = &peer, .msg_namelen = sizeof peer, .msg_iov = &out_parts[i], .msg_iovlen = 1,
            .msg_control = &out_control[i], .msg_controllen = CMSG_SPACE(sizeof(struct in_pktinfo)),
        };
        struct cmsghdr *const head = CMSG_FIRSTHDR(&out[i].msg_hdr);
        head->cmsg_level = IPPROTO_IP;
        head->cmsg_type = IP_PKTINFO;
        head->cmsg_len = CMSG_LEN(sizeof(struct in_pktinfo));
    }
    for (unsigned i = 0; i < READ_AT_ONCE; i++)
        in_parts[i] = (struct iovec){.iov_base = in_bytes[i], .iov_len = sizeof in_bytes[i]};
    return 0;
}

uint8_t *link_room(unsigned master)
{
    if (waiting == SENT_AT_ONCE)
        link_flush();
    const struct in_pktinfo from = {.ipi_spec_dst.s_addr = htonl(FIRST_HOST + master)};
    memcpy(CMSG_DATA(CMSG_FIRSTHDR(&out[waiting].msg_hdr)), &from, sizeof from);
    return out_bytes[waiting];
}

void link_written(size_t bytes)
{
    out_parts[waiting++].iov_len = bytes;
}

void link_flush(void)
{
    for (unsigned first = 0; first < waiting;) {
        const int sent = sendmmsg(sock, out + first, waiting - first, 0);
        if (sent > 0) {
            first += (unsigned)sent;
        } else {
            refused++;
            first++; /* the one that the system refused */
        }
    }
    waiting = 0;
}

static int master_of(struct msghdr *head, unsigned *master)
{
    int found = 0;
    for (struct cmsghdr *each = CMSG_FIRSTHDR(head); each; each = CMSG_NXTHDR(head, each))
        if (each->cmsg_level == IPPROTO_IP && each->cmsg_type == IP_PKTINFO) {
            struct in_pktinfo to;
            memcpy(&to, CMSG_DATA(each), sizeof to);
            *master = ntohl(to.ipi_addr.s_addr) - FIRST_HOST;
            found = 1;
        } else if (each->cmsg_level == SOL_SOCKET && each->cmsg_type == SO_RXQ_OVFL) {
            memcpy(&drops, CMSG_DATA(each), sizeof drops);
        }
    return found;
}

void link_read(void (*take)(unsigned master, uint8_t *data, size_t bytes, uint64_t now))
{
    for (int reads = 0; reads < 4; reads++) {
        for (unsigned i = 0; i < READ_AT_ONCE; i++)
            in[i].msg_hdr = (struct msghdr){
                .msg_iov = &in_parts[i], .msg_iovlen = 1,
                .msg_control = &in_control[i], .msg_controllen = sizeof in_control[i],
            };
        const int count = recvmmsg(sock, in, READ_AT_ONCE, 0, NULL);
        const uint64_t now = now_ns();
        for (int i = 0; i < count; i++) {
            unsigned master;
            if (master_of(&in[i].msg_hdr, &master) && in[i].msg_len <= MOST_BYTES)
                take(master, in_bytes[i], in[i].msg_len, now);
        }
        if (count < READ_AT_ONCE)
            return;
    }
}

void link_wait(uint64_t due_ns)
{
    const uint64_t now = now_ns(), rest_ns = due_ns < now + SHORTEST_SLEEP_NS ? SHORTEST_SLEEP_NS : due_ns - now;
    const struct timespec rest = {(time_t)(rest_ns / 1000000000u), (long)(rest_ns % 1000000000u)};
    struct pollfd wanted = {.fd = sock, .events = POLLIN};
    ppoll(&wanted, 1, &rest, NULL);
}

uint32_t link_drops(void)
{
    return drops;
}

uint64_t link_refused(void)
{
    return refused;
}
