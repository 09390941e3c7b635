#include "literature.h"

#include <math.h>
#include <string.h>

#include "hold.h"
#include "values.h"

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

bool hn_decode_passive(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    double interval_us = 0.0, gap_us = d->has_update ? (double)(t_us - d->t_us) : 0.0;
    hn_vector value, from;
    if (!hn_read_value(d, payload.at, payload.size, value))
        return false;
    if (d->settings.codec == HN_CODEC_PASSIVE_INTERPOLATIVE)
        interval_us = d->settings.set[HN_PASSIVE_INTERPOLATIVE_INTERVAL_MS] * 1000.0;
    bool ramps = gap_us > 0.0 && interval_us > 0.0;
    if (!ramps)
        hn_copy(from, value, axes);
    else if (!on_ramp(d, t_us, from))
        hn_copy(from, d->value, axes);
    double size_n = hn_norm(value, axes), h = hn_threshold(&d->settings, size_n);
    d->of.passive.delta = h + ldexp(1.0, -50) * ((h + 2.0 * size_n) + hn_norm(from, axes));
    d->of.passive.ramp_us = ramps ? fmin(gap_us, interval_us) : 0.0;
    hn_copy(d->of.passive.from, from, axes);
    hn_copy(d->value, value, axes);
    return true;
}

void hn_turn(hn_decoder *d, const double position_m[])
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

void hn_apply_passive(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    const double *direction = d->of.passive.direction;
    double delta = d->of.passive.delta, ahead = 0.0;
    hn_vector base;
    if (!on_ramp(d, t_us, base))
        hn_copy(base, d->value, d->settings.axes);
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
    return fmax(k * (hn_inner(d->of.wall.normal, d->at.position_m, d->settings.axes) / k - d->of.wall.surface_m), 0.0);
}

void hn_apply_wall(const hn_decoder *d, double stimulus_n[])
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

bool hn_decode_wall(hn_decoder *d, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    hn_vector normal, before;
    if (payload.size == 1 + 4 * axes && payload.at[0] == 0) {
        if (!hn_read_singles(payload.at + 1, normal, axes))
            return false;
        hn_copy(d->value, normal, axes);
        d->of.wall.is_wall = false;
        d->of.wall.missing_n = 0.0;
        return true;
    }
    if (payload.size != 5 + 4 * axes || payload.at[0] != 1)
        return false;
    double surface_m = hn_read_single(payload.at + 1);
    bool good = hn_read_singles(payload.at + 5, normal, axes) && fabs(surface_m) <= 2e15;
    EACH_AXIS(i) good = good && fabs(normal[i]) <= 1e6;
    if (!good)
        return false;
    hn_apply_wall(d, before);
    d->of.wall.is_wall = true;
    d->of.wall.surface_m = surface_m;
    hn_copy(d->of.wall.normal, normal, axes);
    d->of.wall.missing_n = fmax(whole_wall(d) - hn_norm(before, axes), 0.0);
    return true;
}

void hn_blend(hn_decoder *d, int64_t t_us)
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
    hn_copy(known[d->of.squares.count++].value, value, d->settings.axes);
    hn_copy(d->value, value, d->settings.axes);
}

bool hn_decode_squares(hn_decoder *d, int64_t t_us, hn_bytes payload)
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
        if (!hn_read_line(d, rest.at, rest.size, value, slope))
            return false;
        remember(d, t_us, value, true);
        hn_copy(d->slope, slope, axes);
        d->of.squares.sum = (uint64_t)floor(2.0 / fraction + 0.5);
        d->of.squares.n = 1;
        d->of.squares.number = number;
        return true;
    }
    if (number != d->of.squares.number || rest.size > 4 * axes || !read_residuals(d, rest, folded))
        return false;
    hn_on_line(d, t_us, value);
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

bool hn_decode_levels(hn_decoder *d, hn_bytes payload)
{
    hn_vector value;
    if (payload.size != 2 * d->settings.axes) {
        if (!hn_read_value(d, payload.at, payload.size, value))
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
    hn_copy(d->value, value, d->settings.axes);
    return true;
}
