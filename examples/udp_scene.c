/* A scene in C: a wall at 10 mm, without libraries. Beside it: hapticnet slave --scene udp:47901

       cc -O2 -o udp_scene udp_scene.c && ./udp_scene 47901

   On several axes, read more numbers of position_m and write as many of force_n. */
#include <arpa/inet.h>
#include <locale.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

/* The force [N] at a position [m]: replace this by your model. */
static double force_n(double position_m)
{
    return position_m > 0.010 ? 400.0 * (position_m - 0.010) : 0.0;
}

int main(int argc, char **argv)
{
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int sock = socket(AF_INET, SOCK_DGRAM, 0);

    setlocale(LC_NUMERIC, "C"); /* numbers have a point */
    here.sin_port = htons((unsigned short)(argc > 1 ? atoi(argv[1]) : 47901));
    if (sock < 0 || bind(sock, (struct sockaddr *)&here, sizeof here) < 0) {
        perror("udp_scene");
        return 1;
    }
    for (;;) {
        char asked[513], answer[128], *at, *time;
        struct sockaddr_in sender;
        socklen_t size = sizeof sender;
        ssize_t length = recvfrom(sock, asked, sizeof asked - 1, 0, (struct sockaddr *)&sender, &size);

        asked[length > 0 ? length : 0] = '\0'; /* {"position_m": [0.012], "t_us": 81000} */
        at = strstr(asked, "\"position_m\": [");
        time = strstr(asked, "\"t_us\": ");
        if (at != NULL && time != NULL) {
            double force = force_n(strtod(at + strlen("\"position_m\": ["), NULL));
            long long t_us = strtoll(time + strlen("\"t_us\": "), NULL, 10);

            length = snprintf(answer, sizeof answer, "{\"force_n\": [%.6g], \"t_us\": %lld}", force, t_us);
            sendto(sock, answer, (size_t)length, 0, (struct sockaddr *)&sender, size);
        }
    }
}
