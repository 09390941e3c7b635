/* Made by make_constants.py from the Python source and docs/refer/payloads.md. Do not edit. */
#ifndef HAPTICNET_CONSTANTS_H
#define HAPTICNET_CONSTANTS_H

/* Sizes of datagrams and fields [B] */
#define HN_DATAGRAM_BYTES 1200
#define HN_HELLO_BYTES 400
#define HN_NAME_BYTES 64
#define HN_REASON_BYTES 200
#define HN_COOKIE_BYTES 16
#define HN_TICKET_BYTES 16

/* Limits of messages */
#define HN_MOST_ELEMENTS 32
#define HN_MOST_AXES 3
#define HN_MOST_COMPONENTS 24
#define HN_LEAST_RATE_HZ 20.0
#define HN_MOST_RATE_HZ 100000.0
#define HN_LEAST_SHARE 0.01
#define HN_MOST_SHARE 0.9
#define HN_LEAST_KEEPALIVE_US 1000
#define HN_MOST_KEEPALIVE_US 50000
#define HN_MOST_CLOCK_US INT64_C(9007199254740991)
#define HN_LEAST_VIBRATION_BUDGET 500.0
#define HN_MOST_VIBRATION_BUDGET 1000000.0
#define HN_LEAST_VIBRATION 0.001
#define HN_MOST_VIBRATION 10.0
#define HN_MOST_PERCENT 100
#define HN_MOST_WAITED_MS 255
#define HN_LEAST_LAW 1e-12
#define HN_MOST_WEBER_FRACTION 1.0
#define HN_MOST_FLOOR_N 1000000000.0
#define HN_MOST_MULTIPLIER 1000.0
#define HN_LARGEST_COMPONENT 1000000000000000.0
#define HN_LARGEST_COUNT 32767

/* What a master asks for unless it is told otherwise */
#define HN_DEFAULT_WEBER_FRACTION 0.05
#define HN_DEFAULT_FLOOR_N 0.025
#define HN_DEFAULT_MULTIPLIER 1.0
#define HN_DEFAULT_RATE_HZ 1000.0

/* Times of a session [us] */
#define HN_HELLO_INTERVAL_US 100000
#define HN_SLOWEST_HELLO_US 1000000
#define HN_REFUSED_RETRY_US 1000000
#define HN_SLOWEST_RETRY_US 16000000
#define HN_NEW_ATTEMPT_US 4000000
#define HN_STALE_AFTER_US 200000
#define HN_STALE_INTERVAL_US 50000
#define HN_ASK_AGAIN_US 1000000
#define HN_MAX_AGE_US 1000000
#define HN_KEEPALIVE_US 45000
#define HN_DOUBT_MARGIN_US 10000
#define HN_CLOSE_INTERVAL_US 50000
#define HN_HALF_OPEN_US 5000000
#define HN_GIVES_WAY_US 1000000
#define HN_KEEP_US 30000000

/* Counts and factors of a session */
#define HN_QUICK_HELLOS 20
#define HN_CLOSE_TRIES 5
#define HN_HELLO_GROWTH 1.25
#define HN_STALE_GROWTH 1.25
#define HN_RECENT 32768
#define HN_TAG_BYTES 16
#define HN_EPOCH_BITS 20
#define HN_LAST_SEQUENCE INT64_C(4294901760)
#define HN_FASTEST_RATE_HZ 10000.0
#define HN_POLICED_SHARE 1.2
#define HN_POLICED_BURST_S 1.0

/* Arrivals, and the estimate of loss */
#define HN_WINDOW 1024
#define HN_LEAP 3000
#define HN_MISORDER 100
#define HN_BEHIND_IN_A_ROW 8
#define HN_REPORT_EVERY 16
#define HN_REPORT_STEPS 100
#define HN_REORDERED 3
#define HN_LOSS_MEMORY 512
#define HN_REMEMBERED_LOSSES 256
#define HN_ASSUMED_ARRIVED 32.0
#define HN_ASSUMED_LOST 2.0

/* Hold [us, N/s] */
#define HN_AGE_LIMIT_US 200000
#define HN_DECAY_US 100000
#define HN_RISE_N_PER_S 50.0
#define HN_LONGEST_STEP_US 20000

/* Repair [us] */
#define HN_INITIAL_TIMEOUT_US 100000
#define HN_SHORTEST_TIMEOUT_US 5000
#define HN_LONGEST_TIMEOUT_US 1000000
#define HN_GRANULARITY_US 5000
#define HN_REPORT_LASTS_US 1000000
#define HN_PACE_STEP_US 500
#define HN_SCHEDULING_US 5000
#define HN_SHORTEST_WAIT_US 2000
#define HN_LONGEST_WAIT_US 6000
#define HN_SHORTEST_KEEPALIVE_US 2000

/* Few positions */
#define HN_LONGEST_SILENCE_US 100000
#define HN_ACK_DELAY_US 20000
#define HN_IDLE_STALE_US 1000000
#define HN_SPARSE_KEEPALIVES 2
#define HN_IDLE_KEEPALIVES 10
#define HN_IDLE_SHARE 2.0
#define HN_IDLE_THRESHOLD_N 0.025
#define HN_FASTEST_M_PER_S 10.0
#define HN_FASTEST_M_PER_S2 100.0
#define HN_FADING_S 0.06
#define HN_STIFFEST 1000000000.0
#define HN_FARTHEST_M 2000000000000000.0
#define HN_LINE_WINDOW_US 12000
#define HN_LINE_SAMPLES 32
#define HN_SIGNIFICANT 25.0
#define HN_UNKNOWN_STIFFNESS 1000.0

/* Recent past: the limit on a force that follows the hand */
#define HN_PAST_GROWTH 1.3
#define HN_PAST_MARGIN_N 0.5
#define HN_LATELY_US 1000000
#define HN_WAY 50
#define HN_LONGEST_AHEAD_US 150000

/* Announced contact */
#define HN_MOST_LAYERS 8
#define HN_STIFFEST_PER_HZ 10.0
#define HN_STIFFEST_N_PER_M 10000.0
#define HN_LARGEST_FORCE_N 1000.0
#define HN_LARGEST_VALUE 1000000.0
#define HN_LARGEST_VISCOSITY 100.0
#define HN_SMALLEST_VALUE 1e-09
#define HN_MODEL_ROUNDING 1e-06
#define HN_LARGEST_EXPONENT 700.0
#define HN_LARGEST_SPEED_M_PER_S 10.0
#define HN_MOST_REMEMBERED 1024
#define HN_MOST_PLAYED 256
#define HN_COST_OF_BEGINNING 5

/* Repair: shares and counts */
#define HN_DOUBT_LIMIT 0.02
#define HN_REPEATS_PER_POSITION 0.12
#define HN_MOST_CREDIT 24.0
#define HN_SILENCES_PER_S 0.0011111111111111111
#define HN_COMPLETE_ABOVE 0.005
#define HN_MOST_DATAGRAMS 200

/* Kinds of datagrams */
enum {
    HN_HELLO = 1,
    HN_WELCOME = 2,
    HN_REFUSE = 3,
    HN_POSITION = 4,
    HN_FORCE = 5,
    HN_KEEPALIVE = 6,
    HN_CLOSE = 7,
    HN_RESET = 8,
    HN_COOKIE = 9,
    HN_NOTICE = 10,
    HN_VIBRATION = 11,
};

/* Codes */
enum {
    HN_CODE_OTHER = 0,
    HN_CODE_VERSION = 1,
    HN_CODE_CODEC = 2,
    HN_CODE_PARAMETER = 3,
    HN_CODE_AXES = 4,
    HN_CODE_FULL = 5,
    HN_CODE_FAILED = 6,
    HN_CODE_KEY = 7,
    HN_CODE_STOPPING = 8,
    HN_CODE_SLOW = 9,
    HN_CODE_SHAPES = 10,
};

#define HN_MOST_PARAMETERS 5

/* What is wrong with a request, or with a slave's scene */
#define HN_WRONG_CODEC "codec must be one of raw, deadband, adaptive-predictive, motion-predictive, linear-predictive, least-squares, level-crossing, velocity-adaptive, passive-extrapolative, passive-interpolative, probabilistic, merging, model-mediated"
#define HN_WRONG_NAME "name must be at most 64 bytes of printable UTF-8"
#define HN_WRONG_SCENE "scene must be at most 64 bytes of printable UTF-8"
#define HN_WRONG_AXES "axes must be 1 to 3"
#define HN_WRONG_RATE_HZ "rate_hz must be between 20 and 100000"
#define HN_WRONG_POSITION_SHARE "position_share must be 0 or between 0.01 and 0.9"
#define HN_WRONG_WEBER_FRACTION "weber_fraction must be 0 or between 1e-12 and 1"
#define HN_WRONG_FLOOR_N "floor_n must be 0 or between 1e-12 and 1e+09"
#define HN_WRONG_MULTIPLIER "multiplier must be 0 or between 1e-12 and 1000"
#define HN_WRONG_VIBRATION_BUDGET "vibration_budget must be between 500 and 1e+06"
#define HN_WRONG_VIBRATION_THRESHOLD "vibration_threshold must be between 0.001 and 10"

/* Codecs: CODEC(symbol, name, the names of its parameters) */
#define HN_CODECS(CODEC) \
    CODEC(HN_CODEC_RAW, "raw", "step_n") \
    CODEC(HN_CODEC_DEADBAND, "deadband", "step_n") \
    CODEC(HN_CODEC_ADAPTIVE_PREDICTIVE, "adaptive-predictive", "horizon_ms, window_ms, jump_thresholds, step_n") \
    CODEC(HN_CODEC_MOTION_PREDICTIVE, "motion-predictive", "horizon_ms, window_ms, stiffest_n_per_m") \
    CODEC(HN_CODEC_LINEAR_PREDICTIVE, "linear-predictive", "slope_samples, horizon_ms, step_n") \
    CODEC(HN_CODEC_LEAST_SQUARES, "least-squares", "updates, horizon_ms, step_fraction, absolute_every, step_n") \
    CODEC(HN_CODEC_LEVEL_CROSSING, "level-crossing", "hysteresis") \
    CODEC(HN_CODEC_VELOCITY_ADAPTIVE, "velocity-adaptive", "speed_gain_s_m, largest_fraction, time_constant_ms, step_n") \
    CODEC(HN_CODEC_PASSIVE_EXTRAPOLATIVE, "passive-extrapolative", "step_n") \
    CODEC(HN_CODEC_PASSIVE_INTERPOLATIVE, "passive-interpolative", "interval_ms, step_n") \
    CODEC(HN_CODEC_PROBABILISTIC, "probabilistic", "loss_probability, deviation_limit, step_n") \
    CODEC(HN_CODEC_MERGING, "merging", "window_ms, step_n") \
    CODEC(HN_CODEC_MODEL_MEDIATED, "model-mediated", "gain, first_n_per_m, deadband, blend_ms")

/* Their parameters: PARAMETER(codec, name, least, most, or zero, whole, default, what it must be) */
#define HN_PARAMETERS(PARAMETER) \
    PARAMETER(HN_CODEC_RAW, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_DEADBAND, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_ADAPTIVE_PREDICTIVE, "horizon_ms", 1.0, 10000.0, 0, 0, 200.0, "between 1 and 10000") \
    PARAMETER(HN_CODEC_ADAPTIVE_PREDICTIVE, "window_ms", 1.0, 1000.0, 0, 0, 17.0, "between 1 and 1000") \
    PARAMETER(HN_CODEC_ADAPTIVE_PREDICTIVE, "jump_thresholds", 0.1, 10.0, 1, 0, 0.0, "0 or between 0.1 and 10") \
    PARAMETER(HN_CODEC_ADAPTIVE_PREDICTIVE, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_MOTION_PREDICTIVE, "horizon_ms", 1.0, 10000.0, 0, 0, 200.0, "between 1 and 10000") \
    PARAMETER(HN_CODEC_MOTION_PREDICTIVE, "window_ms", 1.0, 1000.0, 0, 0, 17.0, "between 1 and 1000") \
    PARAMETER(HN_CODEC_MOTION_PREDICTIVE, "stiffest_n_per_m", 1.0, 60000.0, 0, 0, 10000.0, "between 1 and 60000") \
    PARAMETER(HN_CODEC_LINEAR_PREDICTIVE, "slope_samples", 2.0, 64.0, 0, 1, 5.0, "a whole number between 2 and 64") \
    PARAMETER(HN_CODEC_LINEAR_PREDICTIVE, "horizon_ms", 1.0, 10000.0, 0, 0, 100.0, "between 1 and 10000") \
    PARAMETER(HN_CODEC_LINEAR_PREDICTIVE, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_LEAST_SQUARES, "updates", 2.0, 16.0, 0, 1, 2.0, "a whole number between 2 and 16") \
    PARAMETER(HN_CODEC_LEAST_SQUARES, "horizon_ms", 1.0, 10000.0, 0, 0, 100.0, "between 1 and 10000") \
    PARAMETER(HN_CODEC_LEAST_SQUARES, "step_fraction", 0.01, 1.0, 0, 0, 0.5, "between 0.01 and 1") \
    PARAMETER(HN_CODEC_LEAST_SQUARES, "absolute_every", 1.0, 127.0, 0, 1, 16.0, "a whole number between 1 and 127") \
    PARAMETER(HN_CODEC_LEAST_SQUARES, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_LEVEL_CROSSING, "hysteresis", 0.0, 0.5, 0, 0, 0.25, "between 0 and 0.5") \
    PARAMETER(HN_CODEC_VELOCITY_ADAPTIVE, "speed_gain_s_m", 0.0, 1000.0, 0, 0, 0.5, "between 0 and 1000") \
    PARAMETER(HN_CODEC_VELOCITY_ADAPTIVE, "largest_fraction", 0.0, 1.0, 0, 0, 0.25, "between 0 and 1") \
    PARAMETER(HN_CODEC_VELOCITY_ADAPTIVE, "time_constant_ms", 0.0, 10000.0, 0, 0, 10.0, "between 0 and 10000") \
    PARAMETER(HN_CODEC_VELOCITY_ADAPTIVE, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_PASSIVE_EXTRAPOLATIVE, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_PASSIVE_INTERPOLATIVE, "interval_ms", 0.0, 1000.0, 0, 0, 20.0, "between 0 and 1000") \
    PARAMETER(HN_CODEC_PASSIVE_INTERPOLATIVE, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_PROBABILISTIC, "loss_probability", 0.0, 0.9, 0, 0, 0.1, "between 0 and 0.9") \
    PARAMETER(HN_CODEC_PROBABILISTIC, "deviation_limit", 0.001, 1.0, 0, 0, 0.05, "between 0.001 and 1") \
    PARAMETER(HN_CODEC_PROBABILISTIC, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_MERGING, "window_ms", 0.0, 10000.0, 0, 0, 10.0, "between 0 and 10000") \
    PARAMETER(HN_CODEC_MERGING, "step_n", 1e-12, 1.0, 1, 0, 0.0, "0 or between 1e-12 and 1") \
    PARAMETER(HN_CODEC_MODEL_MEDIATED, "gain", 0.0, 10000.0, 0, 0, 0.1, "between 0 and 10000") \
    PARAMETER(HN_CODEC_MODEL_MEDIATED, "first_n_per_m", 1.0, 1000000.0, 0, 0, 200.0, "between 1 and 1e+06") \
    PARAMETER(HN_CODEC_MODEL_MEDIATED, "deadband", 0.0, 1.0, 0, 0, 0.1, "between 0 and 1") \
    PARAMETER(HN_CODEC_MODEL_MEDIATED, "blend_ms", 0.0, 10000.0, 0, 0, 50.0, "between 0 and 10000")

/* Places of the parameters among those of their codec */
enum { HN_RAW_STEP_N };
enum { HN_DEADBAND_STEP_N };
enum { HN_ADAPTIVE_PREDICTIVE_HORIZON_MS, HN_ADAPTIVE_PREDICTIVE_WINDOW_MS, HN_ADAPTIVE_PREDICTIVE_JUMP_THRESHOLDS, HN_ADAPTIVE_PREDICTIVE_STEP_N };
enum { HN_MOTION_PREDICTIVE_HORIZON_MS, HN_MOTION_PREDICTIVE_WINDOW_MS, HN_MOTION_PREDICTIVE_STIFFEST_N_PER_M };
enum { HN_LINEAR_PREDICTIVE_SLOPE_SAMPLES, HN_LINEAR_PREDICTIVE_HORIZON_MS, HN_LINEAR_PREDICTIVE_STEP_N };
enum { HN_LEAST_SQUARES_UPDATES, HN_LEAST_SQUARES_HORIZON_MS, HN_LEAST_SQUARES_STEP_FRACTION, HN_LEAST_SQUARES_ABSOLUTE_EVERY, HN_LEAST_SQUARES_STEP_N };
enum { HN_LEVEL_CROSSING_HYSTERESIS };
enum { HN_VELOCITY_ADAPTIVE_SPEED_GAIN_S_M, HN_VELOCITY_ADAPTIVE_LARGEST_FRACTION, HN_VELOCITY_ADAPTIVE_TIME_CONSTANT_MS, HN_VELOCITY_ADAPTIVE_STEP_N };
enum { HN_PASSIVE_EXTRAPOLATIVE_STEP_N };
enum { HN_PASSIVE_INTERPOLATIVE_INTERVAL_MS, HN_PASSIVE_INTERPOLATIVE_STEP_N };
enum { HN_PROBABILISTIC_LOSS_PROBABILITY, HN_PROBABILISTIC_DEVIATION_LIMIT, HN_PROBABILISTIC_STEP_N };
enum { HN_MERGING_WINDOW_MS, HN_MERGING_STEP_N };
enum { HN_MODEL_MEDIATED_GAIN, HN_MODEL_MEDIATED_FIRST_N_PER_M, HN_MODEL_MEDIATED_DEADBAND, HN_MODEL_MEDIATED_BLEND_MS };

#endif
