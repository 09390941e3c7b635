#include "decoder.h"

#include <math.h>
#include <string.h>

#include "hold.h"

#define EACH_AXIS(i) for (unsigned i = 0; i < d->settings.axes; i++)

static void copy(double to[], const double from[], unsigned axes)
{
    memcpy(to, from, axes * sizeof *to);
}

static double inner(const double x[], const double y[], unsigned axes)
{
    double total = x[0] * y[0];
    for (unsigned i = 1; i < axes; i++)
        total += x[i] * y[i];
    return total;
}

static void read_halves(const uint8_t *at, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        x[i] = hn_read_half(at + 2 * i);
}

static bool read_singles(const uint8_t *at, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        x[i] = hn_read_single(at + 4 * i);
    return hn_in_range(x, axes);
}

static bool read_doubles(const uint8_t *at, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        x[i] = hn_read_double(at + 8 * i);
    return hn_in_range(x, axes);
}

static bool read_counts(const uint8_t *at, double x[], unsigned axes, double step)
{
    int least = 0;
    for (unsigned i = 0; i < axes; i++) {
        int count = hn_read_count(at + 2 * i);
        least = count < least ? count : least;
        x[i] = count * step;
    }
    return least >= -HN_LARGEST_COUNT;
}

/* Read a value in one of the forms: counts, single, double. */
static bool read_value(const hn_decoder *d, const uint8_t *at, size_t size, double value[])
{
    unsigned axes = d->settings.axes;
    if (size == 2 * axes && d->step_n > 0.0)
        return read_counts(at, value, axes, d->step_n);
    if (size == 4 * axes)
        return read_singles(at, value, axes);
    return size == 8 * axes && d->settings.codec != HN_CODEC_RAW && read_doubles(at, value, axes);
}

/* Lines: a value and a slope. */

static bool read_line(const hn_decoder *d, const uint8_t *at, size_t size, double value[], double slope[])
{
    unsigned axes = d->settings.axes;
    if (size == 4 * axes) {
        double unit = (d->step_n * 1000.0) / d->horizon_ms;
        EACH_AXIS(i) slope[i] = hn_read_count(at + 2 * (axes + i)) * unit;
        return read_value(d, at, 2 * axes, value);
    }
    return (size == 8 * axes || size == 12 * axes) && read_value(d, at, size - 4 * axes, value) &&
           read_singles(at + size - 4 * axes, slope, axes);
}

static void on_line(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    double elapsed_us = fmin((double)(t_us - d->t_us), d->horizon_ms * 1000.0);
    EACH_AXIS(i)
    {
        double end_n = d->value[i] + (d->slope[i] * 1e-6) * elapsed_us;
        stimulus_n[i] = elapsed_us > 0.0 ? hn_limit(end_n) : d->value[i];
    }
}

/* Curves: a value, and where it goes. */

static double share_of_curve(const hn_decoder *d, int64_t t_us)
{
    double s = (double)(t_us - d->t_us) / (d->horizon_ms * 1000.0);
    return s <= 0.0 ? 0.0 : s >= 1.0 ? 1.0 : s * (2.0 - s);
}

/* Read the travel of a curve from its multiples of the threshold. */
static bool read_travel(const hn_decoder *d, const uint8_t *at, const double value[], double travel[])
{
    double threshold_n = hn_threshold(&d->settings, hn_norm(value, d->settings.axes));
    hn_vector end;
    bool good = true;
    read_halves(at, travel, d->settings.axes);
    EACH_AXIS(i)
    {
        good = good && fabs(travel[i]) <= 1024.0;
        travel[i] *= threshold_n;
        end[i] = value[i] + travel[i];
    }
    return good && hn_in_range(end, d->settings.axes);
}

static void on_curve(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    double share = share_of_curve(d, t_us);
    EACH_AXIS(i) stimulus_n[i] = d->value[i] + d->slope[i] * share;
}

/* motion-predictive */

static bool decode_motion(hn_decoder *d, hn_bytes payload)
{
    enum { HOLD, CURVE, SURFACE, COUPLED };
    unsigned axes = d->settings.axes, kind = payload.size > 0 ? payload.at[0] & ~8u : 255;
    if (kind > COUPLED)
        return false;
    bool wide = payload.at[0] & 8;
    size_t values = axes * (wide ? 8u : 4u);
    const size_t rest[] = {0, 2 * axes, 2 * axes + (axes > 1 ? 2 : 0), 4 * axes + 4};
    if (payload.size != 1 + values + rest[kind])
        return false;

    const uint8_t *at = payload.at + 1 + values;
    double stiffest = 1.002 * d->settings.set[HN_MOTION_PREDICTIVE_STIFFEST_N_PER_M], stiffness = 0.0, viscosity = 0.0;
    hn_vector value, travel = {0}, normal = {0};
    if (!(wide ? read_doubles(payload.at + 1, value, axes) : read_singles(payload.at + 1, value, axes)))
        return false;
    if (kind == CURVE && !read_travel(d, at, value, travel))
        return false;
    if (kind == SURFACE) {
        read_halves(at, normal, axes);
        stiffness = axes > 1 ? hn_read_half(at + 2 * axes) : 0.0;
        double along = inner(normal, normal, axes);
        if (!(0.0 < along && along <= stiffest && 0.0 <= stiffness && stiffness <= stiffest))
            return false;
    }
    if (kind == COUPLED) {
        stiffness = hn_read_half(at + 4 * axes);
        viscosity = hn_read_half(at + 4 * axes + 2);
        if (!read_singles(at, travel, axes) ||
            !(0.0 <= stiffness && stiffness <= stiffest && 0.0 <= viscosity && viscosity <= 1000.0))
            return false;
    }
    copy(d->value, value, axes);
    copy(d->slope, travel, axes);
    copy(d->of.motion.normal, normal, axes);
    d->of.motion.kind = (int)kind;
    d->of.motion.stiffness = stiffness;
    d->of.motion.viscosity = viscosity;
    return true;
}

static void on_surface(const hn_decoder *d, double stimulus_n[])
{
    unsigned axes = d->settings.axes;
    const double *normal = d->of.motion.normal, *at = d->at.position_m, k = d->of.motion.stiffness;
    double depth = inner(normal, at, axes), along = inner(normal, normal, axes);
    EACH_AXIS(i)
    {
        double added = depth * normal[i];
        if (k != 0.0)
            added = added + k * (at[i] + (-depth / along) * normal[i]);
        stimulus_n[i] = d->value[i] + added;
    }
    double out = inner(normal, stimulus_n, axes);
    EACH_AXIS(i)
    {
        if (out < 0.0)
            stimulus_n[i] = stimulus_n[i] + (-out / along) * normal[i];
        stimulus_n[i] = hn_limit(stimulus_n[i]);
    }
}

static void apply_motion(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    double share = share_of_curve(d, t_us);
    if (d->of.motion.kind < 2) {
        on_curve(d, t_us, stimulus_n);
    } else if (!d->at.has_position) {
        EACH_AXIS(i) stimulus_n[i] = 0.0;
    } else if (d->of.motion.kind == 2) {
        on_surface(d, stimulus_n);
    } else {
        EACH_AXIS(i)
        {
            double along = (d->value[i] + share * d->slope[i]) + d->of.motion.stiffness * d->at.position_m[i];
            stimulus_n[i] = hn_limit(along + d->of.motion.viscosity * d->at.velocity_m_s[i]);
        }
    }
}

static void measure_velocity(hn_decoder *d, int64_t t_us, const double position_m[])
{
    const double tau = 0.005;
    bool follows = d->at.has_position && t_us > d->at.t_us;
    double passed = tau + (double)(t_us - d->at.t_us) * 1e-6;
    EACH_AXIS(i)
    {
        double way = position_m[i] - d->at.position_m[i];
        d->at.velocity_m_s[i] = follows ? (way + tau * d->at.velocity_m_s[i]) / passed : 0.0;
    }
}

/* passive-extrapolative and passive-interpolative */

static bool on_ramp(const hn_decoder *d, int64_t t_us, double ramp[])
{
    double elapsed_us = (double)(t_us - d->t_us);
    if (!d->has_update || elapsed_us < 0.0 || elapsed_us >= d->of.passive.ramp_us)
        return false;
    double share = elapsed_us / d->of.passive.ramp_us;
    EACH_AXIS(i) ramp[i] = d->of.passive.from[i] + share * (d->value[i] - d->of.passive.from[i]);
    return true;
}

static bool decode_passive(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    double interval_us = 0.0, gap_us = d->has_update ? (double)(t_us - d->t_us) : 0.0;
    hn_vector value, from;
    if (!read_value(d, payload.at, payload.size, value))
        return false;
    if (d->settings.codec == HN_CODEC_PASSIVE_INTERPOLATIVE)
        interval_us = d->settings.set[HN_PASSIVE_INTERPOLATIVE_INTERVAL_MS] * 1000.0;
    bool ramps = gap_us > 0.0 && interval_us > 0.0;
    if (!ramps)
        copy(from, value, axes);
    else if (!on_ramp(d, t_us, from))
        copy(from, d->value, axes);
    double size_n = hn_norm(value, axes), h = hn_threshold(&d->settings, size_n);
    d->of.passive.delta = h + ldexp(1.0, -50) * ((h + 2.0 * size_n) + hn_norm(from, axes));
    d->of.passive.ramp_us = ramps ? fmin(gap_us, interval_us) : 0.0;
    copy(d->of.passive.from, from, axes);
    copy(d->value, value, axes);
    return true;
}

static void turn(hn_decoder *d, const double position_m[])
{
    unsigned axes = d->settings.axes;
    hn_vector way;
    double largest = 0.0, square = 0.0;
    EACH_AXIS(i)
    {
        way[i] = position_m[i] - d->at.position_m[i];
        largest = fmax(largest, fabs(way[i]));
        square += way[i] * way[i];
    }
    if (!d->at.has_position || largest == 0.0)
        return;
    d->of.passive.has_direction = true;
    if (axes == 1) {
        d->of.passive.direction[0] = copysign(1.0, way[0]);
        return;
    }
    if (square < 1e-280) {
        square = 0.0;
        EACH_AXIS(i)
        {
            way[i] /= largest;
            square += way[i] * way[i];
        }
    }
    EACH_AXIS(i) d->of.passive.direction[i] = way[i] / sqrt(square);
}

static void apply_passive(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    const double *direction = d->of.passive.direction;
    double delta = d->of.passive.delta, ahead = 0.0;
    hn_vector base;
    if (!on_ramp(d, t_us, base))
        copy(base, d->value, d->settings.axes);
    EACH_AXIS(i) ahead += (d->value[i] - base[i]) * direction[i];
    delta = ahead > 0.0 ? delta + ahead : delta;
    EACH_AXIS(i) stimulus_n[i] = d->of.passive.has_direction ? base[i] + delta * direction[i] : d->value[i];
}

/* model-mediated */

/* Return the force of the wall with nothing left to blend in. */
static double whole_wall(const hn_decoder *d)
{
    double k = hn_norm(d->of.wall.normal, d->settings.axes);
    if (k == 0.0 || !d->at.has_position)
        return 0.0;
    return fmax(k * (inner(d->of.wall.normal, d->at.position_m, d->settings.axes) / k - d->of.wall.surface_m), 0.0);
}

static void apply_wall(const hn_decoder *d, double stimulus_n[])
{
    double k = hn_norm(d->of.wall.normal, d->settings.axes), size = whole_wall(d) - d->of.wall.missing_n;
    EACH_AXIS(i)
    {
        if (!d->of.wall.is_wall)
            stimulus_n[i] = d->value[i];
        else
            stimulus_n[i] = size > 0.0 ? hn_limit(d->of.wall.normal[i] * (size / k)) : 0.0;
    }
}

static bool decode_wall(hn_decoder *d, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    hn_vector normal, before;
    if (payload.size == 1 + 4 * axes && payload.at[0] == 0) {
        if (!read_singles(payload.at + 1, normal, axes))
            return false;
        copy(d->value, normal, axes);
        d->of.wall.is_wall = false;
        d->of.wall.missing_n = 0.0;
        return true;
    }
    if (payload.size != 5 + 4 * axes || payload.at[0] != 1)
        return false;
    double surface_m = hn_read_single(payload.at + 1);
    bool good = read_singles(payload.at + 5, normal, axes) && fabs(surface_m) <= 2e15;
    EACH_AXIS(i) good = good && fabs(normal[i]) <= 1e6;
    if (!good)
        return false;
    apply_wall(d, before);
    d->of.wall.is_wall = true;
    d->of.wall.surface_m = surface_m;
    copy(d->of.wall.normal, normal, axes);
    d->of.wall.missing_n = fmax(whole_wall(d) - hn_norm(before, axes), 0.0);
    return true;
}

static void blend(hn_decoder *d, int64_t t_us)
{
    double tau = d->settings.set[HN_MODEL_MEDIATED_BLEND_MS] * 1e-3, passed = 0.0;
    if (d->at.has_position && t_us > d->at.t_us)
        passed = (double)(t_us - d->at.t_us) * 1e-6;
    d->of.wall.missing_n = tau > 0.0 ? d->of.wall.missing_n * (tau / (tau + passed)) : 0.0;
}

/* least-squares */

/* Read one number of the Golomb-Rice code from the bit `at` on; return false if the payload ends early. */
static bool read_golomb_rice(hn_bytes data, unsigned k, size_t *at, uint64_t *number)
{
    uint64_t ones = 0;
#define BIT ((unsigned)data.at[*at / 8] >> (7 - *at % 8) & 1u)
    for (; *at < 8 * data.size && BIT; ++*at)
        ones++;
    if (8 * data.size - *at < 1 + k)
        return false;
    *number = ones;
    for (++*at; k > 0; k--, ++*at)
        *number = *number << 1 | BIT;
#undef BIT
    return true;
}

static bool read_residuals(const hn_decoder *d, hn_bytes data, uint64_t folded[])
{
    unsigned k = 0;
    size_t at = 0;
    while (k < 30 && d->of.squares.n << k < d->of.squares.sum)
        k++;
    EACH_AXIS(i) if (!read_golomb_rice(data, k, &at, &folded[i])) return false;
    /* Zeros fill the last byte. */
    return 8 * data.size - at < 8 && (at % 8 == 0 || (uint8_t)(data.at[at / 8] << at % 8) == 0);
}

static double median(double a, double b, double c)
{
    return fmax(fmin(a, b), fmin(fmax(a, b), c));
}

/* Give the line the slope through the known updates, each but the first and last replaced by a median of three. */
static void fit(hn_decoder *d)
{
    const hn_update *known = d->of.squares.known;
    unsigned n = d->of.squares.count, newest = n - 1;
    double total = 0.0, squares = 0.0;
    for (unsigned j = 0; j < n; j++) {
        double t = (double)(known[j].t_us - known[newest].t_us);
        total += t;
        squares += t * t;
    }
    double spread = n * squares - total * total;
    EACH_AXIS(i)
    {
        double product = 0.0;
        for (unsigned j = 0; j < n; j++) {
            double x = known[j].value[i];
            if (0 < j && j < newest)
                x = median(known[j - 1].value[i], x, known[j + 1].value[i]);
            product += (n * (double)(known[j].t_us - known[newest].t_us) - total) * (x - known[newest].value[i]);
        }
        d->slope[i] = spread != 0.0 ? hn_limit((1e6 * product) / spread) : 0.0;
    }
}

static void remember(hn_decoder *d, int64_t t_us, const double value[], bool forget)
{
    hn_update *known = d->of.squares.known;
    unsigned most = (unsigned)d->settings.set[HN_LEAST_SQUARES_UPDATES];
    if (forget)
        d->of.squares.count = 0;
    if (d->of.squares.count == most)
        memmove(known, known + 1, --d->of.squares.count * sizeof *known);
    known[d->of.squares.count].t_us = t_us;
    copy(known[d->of.squares.count++].value, value, d->settings.axes);
    copy(d->value, value, d->settings.axes);
}

static bool decode_squares(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    double fraction = d->settings.set[HN_LEAST_SQUARES_STEP_FRACTION];
    hn_vector value, slope, steps;
    uint64_t folded[HN_MOST_AXES];
    if (payload.size == 0)
        return false;
    unsigned number = payload.at[0] & 0x7f;
    hn_bytes rest = {payload.at + 1, payload.size - 1};
    if (payload.at[0] & 0x80) {
        if (!read_line(d, rest.at, rest.size, value, slope))
            return false;
        remember(d, t_us, value, true);
        copy(d->slope, slope, axes);
        d->of.squares.sum = (uint64_t)floor(2.0 / fraction + 0.5);
        d->of.squares.n = 1;
        d->of.squares.number = number;
        return true;
    }
    if (number != d->of.squares.number || rest.size > 4 * axes || !read_residuals(d, rest, folded))
        return false;
    on_line(d, t_us, value);
    double step = fraction * hn_threshold(&d->settings, hn_norm(value, axes));
    EACH_AXIS(i)
    {
        steps[i] = folded[i] % 2 == 0 ? (double)(folded[i] / 2) : -(double)(folded[i] / 2 + 1);
        value[i] = value[i] + steps[i] * step;
    }
    if (!hn_in_range(value, axes))
        return false;
    remember(d, t_us, value, hn_norm(steps, axes) * fraction > 3.0);
    fit(d);
    EACH_AXIS(i) d->of.squares.sum += folded[i];
    d->of.squares.n += axes;
    if (d->of.squares.n >= 32) {
        d->of.squares.sum /= 2;
        d->of.squares.n /= 2;
    }
    d->of.squares.number = (number + 1) % 128;
    return true;
}

/* level-crossing */

/* Give level `index`; return whether there is one. It is computed anew each time, because a table takes 32 kB. */
static bool find_level(const hn_settings *s, int index, double *level)
{
    double share = ((1.0 - s->set[HN_LEVEL_CROSSING_HYSTERESIS]) / sqrt(s->axes)) * s->multiplier;
    double kappa = fmax(fmin(share * s->weber_fraction, 0.5) - ldexp(1.0, -46), 0.0);
    double phi = (share * s->floor_n) * (1.0 - ldexp(1.0, -36)), end = phi;
    *level = 0.0;
    for (int i = 0; i < index; i++) {
        double next = fmax(end + phi, end / (1.0 - kappa));
        if (i == 4096 || end >= HN_LARGEST_COMPONENT || next > HN_LARGEST_COMPONENT || next <= *level)
            return false;
        *level = next;
        end = next + fmax(kappa * next, phi);
    }
    return true;
}

static bool decode_levels(hn_decoder *d, hn_bytes payload)
{
    hn_vector value;
    if (payload.size != 2 * d->settings.axes) {
        if (!read_value(d, payload.at, payload.size, value))
            return false;
    } else {
        EACH_AXIS(i)
        {
            int index = hn_read_count(payload.at + 2 * i);
            if (!find_level(&d->settings, index < 0 ? -index : index, &value[i]))
                return false;
            value[i] = index < 0 ? -value[i] : value[i];
        }
    }
    copy(d->value, value, d->settings.axes);
    return true;
}

/* All codecs */

static bool decode_curve(hn_decoder *d, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    hn_vector value, travel;
    if (payload.size < 2 * axes || !read_value(d, payload.at, payload.size - 2 * axes, value) ||
        !read_travel(d, payload.at + payload.size - 2 * axes, value, travel))
        return false;
    copy(d->value, value, axes);
    copy(d->slope, travel, axes);
    return true;
}

static bool decode_line(hn_decoder *d, hn_bytes payload)
{
    hn_vector value, slope;
    if (!read_line(d, payload.at, payload.size, value, slope))
        return false;
    copy(d->value, value, d->settings.axes);
    copy(d->slope, slope, d->settings.axes);
    return true;
}

static bool decode_value(hn_decoder *d, hn_bytes payload)
{
    hn_vector value;
    if (!read_value(d, payload.at, payload.size, value))
        return false;
    copy(d->value, value, d->settings.axes);
    return true;
}

static bool decode(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    switch (d->settings.codec) {
    case HN_CODEC_ADAPTIVE_PREDICTIVE:
        return decode_curve(d, payload);
    case HN_CODEC_MOTION_PREDICTIVE:
        return decode_motion(d, payload);
    case HN_CODEC_LINEAR_PREDICTIVE:
        return decode_line(d, payload);
    case HN_CODEC_LEAST_SQUARES:
        return decode_squares(d, t_us, payload);
    case HN_CODEC_LEVEL_CROSSING:
        return decode_levels(d, payload);
    case HN_CODEC_PASSIVE_EXTRAPOLATIVE:
    case HN_CODEC_PASSIVE_INTERPOLATIVE:
        return decode_passive(d, t_us, payload);
    case HN_CODEC_MODEL_MEDIATED:
        return decode_wall(d, payload);
    default:
        return decode_value(d, payload);
    }
}

bool hn_decode(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    if (!decode(d, t_us, payload))
        return false;
    d->has_update = true;
    d->t_us = t_us;
    return true;
}

void hn_decoder_init(hn_decoder *d, const hn_settings *settings)
{
    memset(d, 0, sizeof *d);
    d->settings = *settings;
    hn_get(settings, "step_n", &d->step_n);
    hn_get(settings, "horizon_ms", &d->horizon_ms);
    if (settings->codec == HN_CODEC_LEAST_SQUARES)
        d->of.squares.number = 128;
}

bool hn_follows_motion(int codec)
{
    return codec == HN_CODEC_MOTION_PREDICTIVE || codec == HN_CODEC_PASSIVE_EXTRAPOLATIVE ||
           codec == HN_CODEC_PASSIVE_INTERPOLATIVE || codec == HN_CODEC_MODEL_MEDIATED;
}

void hn_decoder_move(hn_decoder *d, int64_t t_us, const double position_m[])
{
    if (d->settings.codec == HN_CODEC_MOTION_PREDICTIVE) {
        if (d->at.has_position && t_us == d->at.t_us)
            return;
        measure_velocity(d, t_us, position_m);
    } else if (d->settings.codec == HN_CODEC_MODEL_MEDIATED) {
        blend(d, t_us);
    } else {
        turn(d, position_m);
    }
    d->at.has_position = true;
    d->at.t_us = t_us;
    copy(d->at.position_m, position_m, d->settings.axes);
}

void hn_decoder_apply(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    if (!d->has_update) {
        EACH_AXIS(i) stimulus_n[i] = 0.0;
        return;
    }
    switch (d->settings.codec) {
    case HN_CODEC_ADAPTIVE_PREDICTIVE:
        on_curve(d, t_us, stimulus_n);
        break;
    case HN_CODEC_MOTION_PREDICTIVE:
        apply_motion(d, t_us, stimulus_n);
        break;
    case HN_CODEC_LINEAR_PREDICTIVE:
    case HN_CODEC_LEAST_SQUARES:
        on_line(d, t_us, stimulus_n);
        break;
    case HN_CODEC_PASSIVE_EXTRAPOLATIVE:
    case HN_CODEC_PASSIVE_INTERPOLATIVE:
        apply_passive(d, t_us, stimulus_n);
        break;
    case HN_CODEC_MODEL_MEDIATED:
        apply_wall(d, stimulus_n);
        break;
    default:
        copy(stimulus_n, d->value, d->settings.axes);
    }
}
