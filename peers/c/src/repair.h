/* Repair: docs/refer/protocol.md, with all of Replace, Complete, Repeat and Pace. Every payload of raw and deadband
 * decodes on its own, so Complete needs nothing. */
#ifndef HN_REPAIR_H
#define HN_REPAIR_H

#include "hapticnet.h"

void hn_repair_init(hn_repair *r, const hn_settings *settings, int64_t now_us);
/* Note a datagram that was sent, and the stimulus that is held if it is lost. */
void hn_repair_sent(hn_repair *r, uint32_t kind, uint32_t sequence, const double before_n[], int64_t now_us);
void hn_repair_acknowledged(hn_repair *r, uint32_t sequence, int64_t now_us);
void hn_repair_reported(hn_repair *r, double share, double again, int64_t now_us);
/* Whether the present stimulus must be sent now: ask once for each position. */
bool hn_repair_is_due(hn_repair *r, const double stimulus_n[], int64_t now_us);
bool hn_keepalive_is_due(hn_repair *r, int64_t now_us);

#endif
