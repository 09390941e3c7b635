/* Sequence numbers that arrive: docs/refer/protocol.md, "Wrong numbers" and "Report". */
#ifndef HN_ARRIVALS_H
#define HN_ARRIVALS_H

#include "hapticnet.h"

typedef enum { HN_NEW, HN_LATE, HN_DUPLICATE, HN_ASTRAY } hn_arrival;

void hn_arrivals_init(hn_arrivals *a, uint32_t first, bool authentic);
hn_arrival hn_arrive(hn_arrivals *a, uint32_t sequence);

void hn_loss_init(hn_loss *l, uint32_t first);
void hn_loss_arrived(hn_loss *l, uint32_t sequence, bool is_new);
/* Return whether there is loss to report, in per cent. */
bool hn_loss_estimate(const hn_loss *l, uint32_t *share, uint32_t *again);

#endif
