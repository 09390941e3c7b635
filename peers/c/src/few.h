/* Few positions: docs/refer/protocol.md. A line is a position that promises how the tool moves on; a bound tells how
 * far the force may change near the tool. */
#ifndef HN_FEW_H
#define HN_FEW_H

#include "codec.h"

typedef struct {
    int64_t t_us;
    hn_vector position_m, velocity_m_s, acceleration_m_s2;
} hn_line;

typedef struct {
    double stiffness_n_m, damping_n_s_m, stiffening_per_m;
    hn_vector low_m, high_m;
} hn_bound;

/* Which positions a master sends. */
typedef struct {
    hn_settings law; /* of the person, whole */
    double share;
    bool has_line, has_bound, left; /* whether the tool has left the box of this bound */
    hn_line line;
    hn_bound bound;
    double stiffest_n_m;
    hn_update samples[HN_LINE_SAMPLES]; /* a ring */
    unsigned first, count;
} hn_sender;

/* Gives the force applied at the tool minus the one at a place on the line; false if the place makes no difference. */
typedef bool hn_difference(void *context, const double place_m[], double force_n[]);

void hn_line_at(const hn_line *line, int64_t t_us, unsigned axes, double place_m[]);
/* Read the line of a POSITION; return whether it is allowed. */
bool hn_read_promise(hn_bytes payload, unsigned axes, hn_line *line);
/* Read a bound; return false if it is not allowed. An empty one says that there is none: `*has` is false. */
bool hn_read_bound(hn_bytes payload, unsigned axes, bool *has, hn_bound *bound);

void hn_sender_init(hn_sender *s, const hn_settings *law, double share);
void hn_sender_bound(hn_sender *s, bool has, const hn_bound *bound);
/* Write the payload of a position that is to be sent, because of `applied_n` [N] or if it is wanted in any case; return
 * its size, 0 if the line is good enough. */
size_t hn_sender_position(hn_sender *s, int64_t t_us, const double position_m[], double applied_n, bool wanted,
                          hn_difference *difference, void *context, uint8_t *payload);
/* Give the place at which the slave assumes the tool; return whether there is a line. */
bool hn_sender_place(const hn_sender *s, int64_t t_us, double place_m[]);

#endif
