/* What a master does with the datagrams of the slave: docs/refer/protocol.md, "What the master does". */
#ifndef HN_RECEIVING_H
#define HN_RECEIVING_H

#include "more.h"

int64_t hn_silent_us(hn_master *m, int64_t now_us); /* since the newest fresh answer */
bool hn_needs_another(hn_master *m, int64_t now_us);
void hn_reconstruct(hn_master *m, hn_stream *s, int64_t t_us, double stimulus_n[]);
void hn_apply(hn_master *m, hn_stream *s, uint32_t sequence, int64_t t_us, int64_t now_us);

#endif
