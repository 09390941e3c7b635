/* One UDP socket for all masters: each has its own source address in 127/8, chosen per datagram (IP_PKTINFO). */
#ifndef MASTERS_LINK_H
#define MASTERS_LINK_H
#include "wire.h"
#include <stddef.h>
#include <stdint.h>

/* Few are sent at once: a time stamp is of when the first of them was written. */
enum { SENT_AT_ONCE = 16, READ_AT_ONCE = 64 };

int link_open(const char *host, int port); /* 0, or -1 with errno */

/* Room for the next datagram of a master, and its length when it is written. It is sent when enough have come. */
uint8_t *link_room(unsigned master);
void link_written(size_t bytes);
void link_flush(void);

/* Call `take` for all that has arrived, in at most four reads; `now` is the time after the read. */
void link_read(void (*take)(unsigned master, uint8_t *data, size_t bytes, uint64_t now));

/* Sleep until something arrives, or `due_ns`; 20 us if that is sooner, because a program of real-time priority that
   never sleeps is stopped by the kernel for 50 ms each second. */
void link_wait(uint64_t due_ns);

/* Datagrams that the system dropped because this program did not read them; that it refused to send. */
uint32_t link_drops(void);
uint64_t link_refused(void);

uint64_t now_ns(void);
#endif
