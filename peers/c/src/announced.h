/* A model of the contact ahead in the place of the codec's decoder: docs/refer/payloads.md, "What a model does". One
 * that arrives is stepped through the positions since its own, a limited number at each position. */
#ifndef HN_ANNOUNCED_H
#define HN_ANNOUNCED_H

#include "model.h"
#include "past.h"

/* What may be stepped before the next position; shared by all models of a master. */
typedef struct {
    int left;
    bool renewed;
    int64_t t_us;
} hn_allowance;

typedef struct {
    double stiffest_n_m;
    hn_allowance *allowance;
    hn_trail trail;
    uint32_t taken, settled; /* models received; the number of the newest that was applied or replaced */
    bool on_model, is_late, waits;
    hn_model model;
    hn_model late; /* a model that still needs the positions from `next` on */
    uint32_t late_number;
    int late_cost;
    uint64_t next;
    hn_model waiting; /* the newest, which is not begun, and the time that it belongs to */
    int64_t waiting_us;
} hn_announced;

size_t hn_announced_bytes(unsigned axes);
void hn_announced_init(hn_announced *a, unsigned axes, hn_allowance *allowance, uint8_t **memory);
void hn_announced_begin(hn_announced *a, double stiffest_n_m);
void hn_announced_move(hn_announced *a, int64_t t_us, const double position_m[]);
/* Take in a payload; return false if it must be refused. Those of the codec go to `decode`. */
bool hn_announced_decode(hn_announced *a, int64_t t_us, hn_bytes payload);
/* Note that the newest payload is one of the codec. */
void hn_announced_end_model(hn_announced *a);

#endif
