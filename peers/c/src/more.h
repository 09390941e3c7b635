/* What a master needs beyond the smallest one: few positions, announced contact, the limit on codecs that follow the
 * hand. A program that does not call hn_more_init links none of it: the master reaches it by these functions only. */
#ifndef HN_MORE_H
#define HN_MORE_H

#include "announced.h"
#include "few.h"
#include "messages.h"

typedef enum { HN_REFUSED, HN_APPLIED, HN_LATER } hn_outcome;

/* A force whose model must catch up before it is applied. */
typedef struct {
    uint32_t number, sequence;
    int64_t t_us;
} hn_late;

typedef struct {
    void (*begin)(hn_master *m, hn_stream *s, const hn_grant *grant);
    hn_outcome (*decode)(hn_master *m, hn_stream *s, uint32_t sequence, int64_t t_us, hn_bytes payload);
    /* Give the stimulus of a session for a time, at the position of the newest tick. */
    void (*reconstruct)(hn_master *m, hn_stream *s, int64_t t_us, double stimulus_n[]);
    void (*advance)(hn_master *m, int64_t now_us); /* that tick has come */
    /* Move the models to the master's position; then give the newest force whose model has caught up, if any. */
    void (*move)(hn_master *m, int64_t now_us);
    bool (*caught_up)(hn_master *m, hn_stream *s, hn_late *late);
    int (*model_state)(hn_master *m, const hn_stream *s); /* below 0: nothing is announced */
    bool (*on_model)(hn_master *m, const hn_stream *s);
    /* Few positions: the payload of a tick, 0 bytes if none is to be sent; then its place on the line. */
    size_t (*promise)(hn_master *m, int64_t now_us, bool wanted, uint8_t *payload);
    void (*follow)(hn_master *m, int64_t now_us, bool is_known); /* false: the newest line was not sent */
    bool (*bound)(hn_master *m, hn_bytes payload); /* whether it is allowed */
} hn_more_ops;

/* Of one session; NULL: not in use. */
typedef struct {
    hn_past *past;
    hn_announced *announced, *line_announced;
    hn_decoder *line; /* a second decoder, at the places on the line */
} hn_parts;

typedef struct {
    hn_parts owns, uses; /* what there is memory for; what the session has */
    hn_late late[2];
    unsigned lates;
} hn_side;

struct hn_more {
    const hn_more_ops *ops;
    unsigned axes; /* of the request that it was made for, and what that asked */
    double rate_hz;
    bool follows, announced, sparse;
    hn_allowance allowance;
    bool has_position; /* of the newest tick in which the force was applied */
    hn_vector position_m;
    int64_t position_us;
    hn_sender *sender;
    hn_side sides[2];
};

/* Return the time of the newest position whose answer may have arrived. */
int64_t hn_felt_time(const hn_master *m, const hn_stream *s, int64_t now_us);

#endif
