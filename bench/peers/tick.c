/* The limit of a 1 kHz loop: sleeps to absolute times and prints how late each wake-up was [us], one a line. */
#define _GNU_SOURCE
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { NS_PER_S = 1000000000, PERIOD_NS = 1000000 };

int main(int argc, char **argv)
{
    const long ticks = argc > 1 ? atol(argv[1]) : 1000;
    const int fifo_priority = argc > 2 ? atoi(argv[2]) : 0;
    if (fifo_priority) {
        const struct sched_param param = {.sched_priority = fifo_priority};
        if (sched_setscheduler(0, SCHED_FIFO, &param)) {
            perror("SCHED_FIFO");
            return 1;
        }
    }
    double *late_us = calloc((size_t)ticks, sizeof *late_us);
    struct timespec due, now;
    if (!late_us || clock_gettime(CLOCK_MONOTONIC, &due))
        return 1;
    for (long i = 0; i < ticks; i++) {
        due.tv_nsec += PERIOD_NS;
        if (due.tv_nsec >= NS_PER_S) {
            due.tv_nsec -= NS_PER_S;
            due.tv_sec++;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        late_us[i] = (double)(now.tv_sec - due.tv_sec) * 1e6 + (double)(now.tv_nsec - due.tv_nsec) / 1e3;
    }
    for (long i = 0; i < ticks; i++)
        printf("%.3f\n", late_us[i]);
    free(late_us);
    return 0;
}
