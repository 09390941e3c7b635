/* The hold: docs/understand/safety.md, "Protection stages". A stimulus is applied as long as the link is alive, decays
 * to zero after the age limit, and rises again no faster than HN_RISE_N_PER_S. */
#ifndef HN_HOLD_H
#define HN_HOLD_H

#include "hapticnet.h"

void hn_hold_init(hn_hold *h, unsigned axes);
void hn_hold_receive(hn_hold *h, const double stimulus_n[], int64_t now_us); /* a new stimulus */
void hn_hold_follow(hn_hold *h, const double stimulus_n[], int64_t now_us);  /* the same one, at another time */
void hn_hold_confirm(hn_hold *h, int64_t now_us);
void hn_hold_restart(hn_hold *h); /* the next stimulus rises from the force that is applied now */
void hn_hold_release(hn_hold *h); /* apply nothing; later the force rises from zero */
void hn_hold_value(hn_hold *h, double force_n[], int64_t now_us);

double hn_norm(const double x[], unsigned axes);

#endif
