/* The recent past: docs/understand/safety.md, "Protection stages". A force that follows the hand stays near the largest
 * that the same updates give at positions that the slave has answered within the last second. */
#ifndef HN_PAST_H
#define HN_PAST_H

#include "decoder.h"

/* Positions with their times, oldest first; the oldest are overwritten. */
typedef struct {
    unsigned axes, room;
    uint64_t end; /* number of positions so far; the index of the newest is one less */
    int64_t *t_us;
    double *position_m;
} hn_trail;

size_t hn_trail_bytes(unsigned axes, unsigned room);
void hn_trail_init(hn_trail *t, unsigned axes, unsigned room, uint8_t **memory);
void hn_trail_add(hn_trail *t, int64_t t_us, const double position_m[]);
int64_t hn_trail_time(const hn_trail *t, uint64_t index);
const double *hn_trail_place(const hn_trail *t, uint64_t index);
/* Return the oldest index that is remembered, if at most `most` are. */
uint64_t hn_trail_start(const hn_trail *t, uint64_t most);
/* Return the first index from `start` on whose time is later; the end if there is none. */
uint64_t hn_trail_after(const hn_trail *t, uint64_t start, int64_t t_us);

typedef struct {
    hn_decoder behind; /* the same updates at the newest answered position */
    hn_trail trail;
    uint64_t start; /* of the positions of the last second, and the time there */
    int64_t start_us;
    bool answered, is_free;
    int64_t answered_us, free_us; /* nothing is limited while answers are at most so old */
    double limit_n;
    int64_t *peak_us; /* answered forces of the last second; each is larger than those after it */
    double *peak_n;
    unsigned room, first, peaks;
} hn_past;

/* For so many positions a second. `hn_past_init` takes its memory from the start of `memory`. */
size_t hn_past_bytes(unsigned axes, double rate_hz);
void hn_past_init(hn_past *p, unsigned axes, double rate_hz, uint8_t **memory);
void hn_past_begin(hn_past *p, const hn_settings *settings, int64_t free_us);
/* Take in a payload that the master's own decoder has taken. */
void hn_past_decode(hn_past *p, int64_t t_us, hn_bytes payload);
/* Limit what the master's own decoder gives for a time at its position. */
void hn_past_limit(hn_past *p, int64_t t_us, const double position_m[], int64_t position_us, double force_n[]);

#endif
