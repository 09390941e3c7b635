/* Answer one in K UDP datagrams on 127.0.0.1 with itself: gcc -O2 -o echo bench/peers/echo.c; ./echo K

   The limit of a slave that gets a datagram per position: it reads and sends in batches, and does nothing with them.
   Prints its port. Ends with its parent, or on a signal. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/socket.h>

enum { AT_ONCE = 64, LARGEST = 1500, BUFFER_BYTES = 4 << 20 };

static unsigned char bytes[AT_ONCE][LARGEST];
static struct sockaddr_in sources[AT_ONCE];
static struct iovec parts[AT_ONCE], answer_parts[AT_ONCE];
static struct mmsghdr messages[AT_ONCE], answers[AT_ONCE];

int main(int argc, char **argv)
{
    const long each = argc == 2 ? atol(argv[1]) : 0;
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t length = sizeof address;
    const int size = BUFFER_BYTES, sock = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    if (each < 1) {
        fprintf(stderr, "usage: echo K\n");
        return 2;
    }
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (sock < 0 || bind(sock, (const struct sockaddr *)&address, sizeof address)
        || getsockname(sock, (struct sockaddr *)&address, &length)) {
        perror("echo");
        return 1;
    }
    if (setsockopt(sock, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof size))
        setsockopt(sock, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    for (int i = 0; i < AT_ONCE; i++)
        parts[i] = (struct iovec){.iov_base = bytes[i], .iov_len = LARGEST};
    for (long seen = 0;;) {
        for (int i = 0; i < AT_ONCE; i++)
            messages[i].msg_hdr = (struct msghdr){
                .msg_name = &sources[i], .msg_namelen = sizeof sources[i], .msg_iov = &parts[i], .msg_iovlen = 1};
        const int count = recvmmsg(sock, messages, AT_ONCE, 0, NULL);
        if (count <= 0) {
            struct pollfd wanted = {.fd = sock, .events = POLLIN};
            poll(&wanted, 1, -1);
            continue;
        }
        unsigned chosen = 0;
        for (int i = 0; i < count; i++)
            if (seen++ % each == 0) {
                answer_parts[chosen] = (struct iovec){.iov_base = bytes[i], .iov_len = messages[i].msg_len};
                answers[chosen].msg_hdr = (struct msghdr){.msg_name = &sources[i], .msg_namelen = sizeof sources[i],
                                                          .msg_iov = &answer_parts[chosen], .msg_iovlen = 1};
                chosen++;
            }
        if (chosen)
            sendmmsg(sock, answers, chosen, 0);
    }
}
