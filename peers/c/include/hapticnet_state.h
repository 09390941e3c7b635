/* The state of both ends. Its fields are the library's own: a program needs the sizes only, to keep the state where it
 * likes. Times are in microseconds of the program's clock, lengths in metres, forces in newtons. */
#ifndef HAPTICNET_STATE_H
#define HAPTICNET_STATE_H

typedef double hn_vector[HN_MOST_AXES];

typedef struct {
    bool is_set;
    uint32_t value;
} hn_maybe; /* a uint32 or nil */

/* Which sequence numbers have arrived. */
typedef struct {
    uint32_t newest;
    uint32_t seen[HN_WINDOW / 32]; /* a bit for each number, modulo HN_WINDOW */
    hn_maybe after_leap;           /* the number that would show that a leap is right */
    uint32_t behind;               /* the last arrival far behind the newest, and how many came in a row */
    unsigned behind_run;
    bool authentic; /* a seal proves each number */
} hn_arrivals;

/* The share of lost datagrams, and of losses that another one follows. */
typedef struct {
    uint32_t newest;
    unsigned arrived; /* a bit for each of the newest HN_REORDERED numbers */
    double count, lost, before_next, lost_again;
    bool was_lost;
} hn_loss;

typedef struct {
    bool has_position; /* and the time and the velocity [m/s] there */
    int64_t t_us;
    hn_vector position_m, velocity_m_s;
} hn_motion;

typedef struct {
    int64_t t_us;
    hn_vector value;
} hn_update;

/* The numbers of a request that a codec works with. */
typedef struct {
    int codec;
    unsigned axes;
    double set[HN_MOST_PARAMETERS]; /* its parameters, in its order */
    double weber_fraction, floor_n, multiplier;
} hn_settings;

/* Turns payloads into the stimulus to apply. */
typedef struct {
    hn_settings settings;
    double step_n, horizon_ms; /* of its parameters, zero without one */
    bool has_update;
    int64_t t_us; /* of the newest update */
    hn_vector value;
    hn_vector slope; /* of a line [N/s], or the travel of a curve [N] */
    hn_motion at;    /* the receiver's own, if the codec follows it */
    union {
        struct {
            int kind;
            hn_vector normal;
            double stiffness, viscosity;
        } motion;
        struct {
            bool has_direction;
            hn_vector direction, from;
            double ramp_us, delta;
        } passive;
        struct {
            bool is_wall;
            hn_vector normal;
            double surface_m, missing_n;
        } wall;
        struct {
            hn_update known[16]; /* oldest first */
            unsigned count;
            unsigned number; /* of the newest update; above 127: none */
            uint64_t sum, n;
        } squares;
    } of;
} hn_decoder;

/* The stimulus that is applied: held while the link is alive, then released. */
typedef struct {
    unsigned axes;
    hn_vector stimulus_n;
    int64_t now_us, age_us, elapsed_us;
    bool starts, whole, kept; /* kept: at any age, because it is small */
    double share, applied_n;
} hn_hold;

/* One granted session at the master's end. */
typedef struct {
    bool answers; /* whether datagrams of this session count */
    uint32_t number, sequence;
    hn_maybe newest_force, confirmed;
    unsigned positions;
    hn_arrivals arrivals;
    hn_loss loss;
    hn_decoder decoder;
    bool felt; /* whether a FORCE was applied; its time stamp and arrival */
    int64_t felt_t_us, felt_us;
    bool sparse, predicted, announced; /* what was granted: few positions, a predicted hand, announced contact */
    bool owes; /* whether a position waits to acknowledge something */
    int64_t owes_us, confirmed_us;
} hn_stream;

struct hn_master;

/* How sealed sessions are made; NULL for open ones. hapticnet_sealed.h has it. */
typedef struct {
    void (*ask)(struct hn_master *m, const uint8_t *request, size_t size);
    void (*hello)(void *keys, const uint8_t **noise1, size_t *size, const uint8_t **mac);
    size_t (*answer)(void *keys, const uint8_t *noise2, size_t size, uint8_t *plain);
    void (*use)(void *keys, unsigned stream);
    size_t (*seal)(void *keys, unsigned stream, uint8_t *data, size_t size);
    bool (*open)(void *keys, unsigned stream, const uint8_t *data, size_t size, uint32_t sequence, size_t body,
                 uint8_t *plain);
} hn_sealing;

typedef struct hn_master {
    hn_state state;
    hn_request request;
    hn_entropy *entropy;
    void *context;
    const hn_sealing *sealing;
    void *keys;
    hn_counts counts;
    char reason[HN_REASON_BYTES + 1];
    unsigned code;
    /* asking for a session */
    bool asking, attempted, hinted, has_cookie, tried, hello_due;
    uint32_t nonce;
    uint8_t cookie[HN_COOKIE_BYTES];
    int64_t clock_us, cookie_us, tried_us, hello_interval_us, refused_wait_us;
    unsigned tries;
    /* the sessions: `now` is that of the positions, `felt` that of the force. Two of them while they change. */
    bool had_session;
    uint8_t ticket[HN_TICKET_BYTES];
    char scene[HN_NAME_BYTES + 1];
    int64_t keepalive_us, position_period_us, position_due_us;
    hn_stream streams[2];
    hn_stream *now, *felt;
    /* whether answers are fresh */
    int64_t heard_us, newest_t_us, stale_us, pace_us, too_old_us;
    bool too_old, doubted;
    double pace_interval_us;
    /* this period */
    bool has_position, position_due;
    hn_vector position_m;
    int64_t position_us;
    uint8_t payload[1 + 8 * HN_MOST_AXES];
    size_t payload_size;
    /* few positions: whether next to no force is applied, and how long after a position the slave may answer */
    bool idle;
    double idle_below_n;
    int64_t ahead_us;
    hn_hold hold;
    /* closing */
    bool close_due, close_timed;
    int64_t close_us;
    unsigned closes_left;
} hn_master;

/* The deadband's or raw's encoder: the stimulus that the master holds, and how far the next may be from it. */
typedef struct {
    hn_settings settings;
    double step_n;
    hn_vector held_n;
    double threshold_n; /* below 0: the next stimulus is sent */
} hn_encoder;

/* A datagram without acknowledgement, and the stimulus that is held if it is lost. */
typedef struct {
    uint32_t sequence;
    int64_t sent_us;
    hn_vector before_n;
} hn_sent;

enum { HN_MOST_SENT = 128 };

/* When the slave sends although its encoder does not. */
typedef struct {
    hn_settings settings;
    hn_sent sent[HN_MOST_SENT]; /* a ring */
    unsigned first, count;
    bool measured;
    int64_t keepalive_us, since_us, spoke_us, reported_us;
    double smoothed_us, deviation_us, overdue_us, timeout_us, late_us;
    double share, again, credit; /* of losses, as the master reports them */
    unsigned needed;
} hn_repair;

typedef struct {
    uint8_t bytes[HN_ADDRESS_BYTES];
    size_t size;
} hn_address;

/* A cookie that was given out, and whether its request was read. */
typedef struct {
    hn_address address;
    uint32_t nonce;
    uint8_t cookie[HN_COOKIE_BYTES];
    bool given, spent;
} hn_cookie;

/* A session that was granted and has no position yet. */
typedef struct {
    bool waits, continues;
    hn_address address;
    uint32_t nonce, number, first;
    uint8_t ticket[HN_TICKET_BYTES];
    hn_settings settings;
    double rate_hz;
    int64_t clock_us, heard_us;
    const uint8_t *noise2; /* of a sealed WELCOME */
    size_t noise2_size;
} hn_greeting;

struct hn_slave;

/* The same for a slave. */
typedef struct {
    bool (*is_for_us)(void *keys, uint32_t nonce, uint32_t sequence, const uint8_t *noise1, size_t size,
                      const uint8_t *mac);
    size_t (*read)(void *keys, uint32_t nonce, uint32_t sequence, const uint8_t *noise1, size_t size, uint8_t *plain);
    bool (*is_listed)(void *keys);
    size_t (*answer)(struct hn_slave *s, const uint8_t *payload, size_t size, const uint8_t **noise2);
    void (*use)(void *keys, bool half_open);
    size_t (*seal)(void *keys, unsigned transport, uint8_t *data, size_t size);
    bool (*open)(void *keys, unsigned transport, const uint8_t *data, size_t size, uint32_t sequence, size_t body,
                 uint8_t *plain);
} hn_slave_sealing;

typedef struct hn_slave {
    const hn_slave_sealing *sealing; /* NULL for open sessions */
    void *keys;
    const char *scene;
    unsigned axes;
    double fastest_rate_hz;
    hn_entropy *entropy;
    void *context;
    hn_counts counts;
    hn_cookie cookies[8]; /* a ring */
    unsigned next_cookie;
    hn_greeting half_open;
    /* the session */
    bool open;
    hn_address address;
    uint32_t number, sequence;
    uint8_t ticket[HN_TICKET_BYTES];
    double rate_hz, full_us; /* positions that are served, and when their bucket is full again */
    hn_maybe newest_force;
    hn_arrivals arrivals;
    hn_encoder encoder;
    hn_repair repair;
    int64_t heard_us, position_t_us;
    bool waits; /* whether a position waits for its force */
    hn_vector position_m;
} hn_slave;

#endif
