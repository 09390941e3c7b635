#include "few.h"

#include <math.h>
#include <string.h>

#include "hold.h"
#include "values.h"

/* Lines and bounds */

void hn_line_at(const hn_line *line, int64_t t_us, unsigned axes, double place_m[])
{
    int64_t elapsed_us = t_us - line->t_us < HN_LONGEST_SILENCE_US ? t_us - line->t_us : HN_LONGEST_SILENCE_US;
    double e = 1e-6 * (double)elapsed_us, f = fmin(e, HN_FADING_S);
    double bent = f * f * (0.5 - f / (6.0 * HN_FADING_S)) + 0.5 * HN_FADING_S * (e - f);
    for (unsigned i = 0; i < axes; i++) {
        double along = line->position_m[i] + e * line->velocity_m_s[i];
        place_m[i] = elapsed_us > 0 ? hn_limit(along + bent * line->acceleration_m_s2[i]) : line->position_m[i];
    }
}

static bool read_halves(const uint8_t *at, unsigned axes, double largest, double x[])
{
    bool good = true;
    for (unsigned i = 0; i < axes; i++) {
        x[i] = hn_read_half(at + 2 * i);
        good = good && fabs(x[i]) <= largest; /* NaN is not */
    }
    return good;
}

bool hn_read_promise(hn_bytes payload, unsigned axes, hn_line *line)
{
    memset(line, 0, sizeof *line);
    if (payload.size != 4 * axes && payload.size != 6 * axes && payload.size != 8 * axes)
        return false;
    return hn_read_singles(payload.at, line->position_m, axes) &&
           (payload.size < 6 * axes ||
            read_halves(payload.at + 4 * axes, axes, HN_FASTEST_M_PER_S, line->velocity_m_s)) &&
           (payload.size < 8 * axes ||
            read_halves(payload.at + 6 * axes, axes, HN_FASTEST_M_PER_S2, line->acceleration_m_s2));
}

static bool is_moving(const double x[], unsigned axes)
{
    bool moves = false;
    for (unsigned i = 0; i < axes; i++)
        moves = moves || x[i] != 0.0;
    return moves;
}

static size_t write_promise(const hn_line *line, unsigned axes, uint8_t *payload)
{
    bool bends = is_moving(line->acceleration_m_s2, axes), moves = bends || is_moving(line->velocity_m_s, axes);
    for (unsigned i = 0; i < axes; i++) {
        hn_store_single(payload + 4 * i, line->position_m[i]);
        hn_store_half(payload + 4 * axes + 2 * i, line->velocity_m_s[i]);
        hn_store_half(payload + 6 * axes + 2 * i, line->acceleration_m_s2[i]);
    }
    return (bends ? 8 : moves ? 6 : 4) * axes;
}

bool hn_read_bound(hn_bytes payload, unsigned axes, bool *has, hn_bound *bound)
{
    *has = false;
    if (payload.size == 0)
        return true;
    if (payload.size != 4 * (3 + 2 * axes))
        return false;
    bound->stiffness_n_m = hn_read_single(payload.at);
    bound->damping_n_s_m = hn_read_single(payload.at + 4);
    bound->stiffening_per_m = hn_read_single(payload.at + 8);
    bool good = 0.0 <= bound->stiffness_n_m && bound->stiffness_n_m <= HN_STIFFEST && 0.0 <= bound->damping_n_s_m &&
                bound->damping_n_s_m <= HN_STIFFEST && 0.0 <= bound->stiffening_per_m &&
                bound->stiffening_per_m <= HN_STIFFEST;
    for (unsigned i = 0; i < axes; i++) {
        bound->low_m[i] = hn_read_single(payload.at + 12 + 4 * i);
        bound->high_m[i] = hn_read_single(payload.at + 12 + 4 * (axes + i));
        good = good && -HN_FARTHEST_M <= bound->low_m[i] && bound->low_m[i] <= bound->high_m[i] &&
               bound->high_m[i] <= HN_FARTHEST_M;
    }
    *has = good;
    return good;
}

static bool is_inside(const hn_bound *bound, const double x[], unsigned axes)
{
    bool inside = true;
    for (unsigned i = 0; i < axes; i++)
        inside = inside && bound->low_m[i] <= x[i] && x[i] <= bound->high_m[i];
    return inside;
}

static void move_inside(const hn_bound *bound, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++) {
        x[i] = bound->low_m[i] > x[i] ? bound->low_m[i] : x[i];
        x[i] = bound->high_m[i] < x[i] ? bound->high_m[i] : x[i];
    }
}

static double apart(const double x[], const double y[], unsigned axes)
{
    hn_vector way;
    for (unsigned i = 0; i < axes; i++)
        way[i] = x[i] - y[i];
    return hn_norm(way, axes);
}

/* Give the mean velocity over a step that ends where a line starts. */
static void arriving(const hn_line *line, int64_t step_us, unsigned axes, double velocity_m_s[])
{
    for (unsigned i = 0; i < axes; i++)
        velocity_m_s[i] = line->velocity_m_s[i] + (-0.5e-6 * (double)step_us) * line->acceleration_m_s2[i];
}

/* The samples of the last milliseconds */

static const hn_update *sample(const hn_sender *s, unsigned back) /* 0: the newest */
{
    return &s->samples[(s->first + s->count - 1 - back) % HN_LINE_SAMPLES];
}

static void add_sample(hn_sender *s, int64_t t_us, const double x[])
{
    hn_update *added = &s->samples[(s->first + s->count) % HN_LINE_SAMPLES];
    if (s->count == HN_LINE_SAMPLES)
        s->first = (s->first + 1) % HN_LINE_SAMPLES;
    else
        s->count++;
    added->t_us = t_us;
    hn_copy(added->value, x, s->law.axes);
}

static int64_t newest_step_us(const hn_sender *s)
{
    return s->count > 1 ? sample(s, 0)->t_us - sample(s, 1)->t_us : 0;
}

static void newest_velocity(hn_sender *s, int64_t t_us, const double x[], double velocity_m_s[])
{
    unsigned axes = s->law.axes;
    memset(velocity_m_s, 0, axes * sizeof *velocity_m_s);
    if (s->count == 0)
        return;
    for (unsigned i = 0; i < axes; i++)
        velocity_m_s[i] = ((x[i] - sample(s, 0)->value[i]) / (double)(t_us - sample(s, 0)->t_us)) * 1e6;
    if (hn_norm(velocity_m_s, axes) <= HN_FASTEST_M_PER_S)
        return;
    s->count = 0; /* the hand jumped: earlier samples say nothing */
    memset(velocity_m_s, 0, axes * sizeof *velocity_m_s);
}

/* Give velocity and acceleration at the newest sample: least squares over those before it, through it. */
static void fit_parabola(const hn_sender *s, double velocity[], double acceleration[])
{
    unsigned axes = s->law.axes;
    double squares = 0.0, cubes = 0.0, fourths = 0.0, moved_m2 = 0.0;
    int count = 0;
    hn_vector first = {0}, second = {0}, moved;
    for (unsigned back = s->count; back-- > 1;) {
        int64_t before_us = sample(s, back)->t_us - sample(s, 0)->t_us;
        if (before_us >= 0 || before_us < -HN_LINE_WINDOW_US)
            continue;
        double elapsed_s = 1e-6 * (double)before_us, half_s2 = 0.5 * elapsed_s * elapsed_s;
        for (unsigned i = 0; i < axes; i++)
            moved[i] = sample(s, back)->value[i] - sample(s, 0)->value[i];
        squares += elapsed_s * elapsed_s;
        cubes += elapsed_s * half_s2;
        fourths += half_s2 * half_s2;
        moved_m2 += hn_inner(moved, moved, axes);
        count++;
        for (unsigned i = 0; i < axes; i++) {
            first[i] = first[i] + elapsed_s * moved[i];
            second[i] = second[i] + half_s2 * moved[i];
        }
    }
    double divisor = squares * fourths - cubes * cubes;
    if (divisor > 1e-6 * squares * fourths) {
        for (unsigned i = 0; i < axes; i++) {
            acceleration[i] = (second[i] * squares - first[i] * cubes) / divisor;
            velocity[i] = (first[i] * fourths - second[i] * cubes) / divisor;
        }
        double left_m2 = moved_m2 - hn_inner(velocity, first, axes) - hn_inner(acceleration, second, axes);
        if (hn_inner(acceleration, acceleration, axes) * divisor * (count - 2) > HN_SIGNIFICANT * left_m2 * squares)
            return;
    }
    for (unsigned i = 0; i < axes; i++) {
        velocity[i] = first[i] / (squares != 0.0 ? squares : 1.0);
        acceleration[i] = 0.0;
    }
}

static void round_to_halves(const double x[], double largest, unsigned axes, double rounded[])
{
    uint8_t bytes[2];
    for (unsigned i = 0; i < axes; i++) {
        hn_store_half(bytes, fmax(-largest, fmin(x[i], largest)));
        rounded[i] = hn_read_half(bytes) + 0.0;
    }
}

/* Promise a line from a sample on, which was reached with a velocity. */
static void promise(hn_sender *s, int64_t t_us, const double x[], const double velocity[])
{
    unsigned axes = s->law.axes;
    int64_t step_us = newest_step_us(s);
    hn_vector speed, change, arrives = {0};
    fit_parabola(s, speed, change);
    s->has_line = true;
    s->line.t_us = t_us;
    hn_copy(s->line.position_m, x, axes);
    round_to_halves(change, HN_FASTEST_M_PER_S2, axes, s->line.acceleration_m_s2);
    round_to_halves(speed, HN_FASTEST_M_PER_S, axes, s->line.velocity_m_s);
    if (s->has_bound && is_inside(&s->bound, x, axes)) {
        arriving(&s->line, step_us, axes, arrives);
        if (s->bound.damping_n_s_m * apart(velocity, arrives, axes) <= s->share * hn_threshold(&s->law, 0.0))
            return;
    }
    /* Outside the box the slave may find something viscous, too. */
    for (unsigned i = 0; i < axes; i++)
        speed[i] = velocity[i] + (0.5e-6 * (double)step_us) * s->line.acceleration_m_s2[i];
    round_to_halves(speed, HN_FASTEST_M_PER_S, axes, s->line.velocity_m_s);
}

/* Which positions are sent */

/* Give the velocity with which the slave steps its scene: the line ends at the sides of the box. */
static void followed_velocity(const hn_sender *s, int64_t t_us, int64_t step_us, bool outside, double velocity_m_s[])
{
    unsigned axes = s->law.axes;
    hn_vector now_m, before_m;
    if (step_us <= 0 || t_us - step_us < s->line.t_us) {
        arriving(&s->line, step_us, axes, velocity_m_s);
        return;
    }
    hn_line_at(&s->line, t_us, axes, now_m);
    hn_line_at(&s->line, t_us - step_us, axes, before_m);
    if (!outside) {
        move_inside(&s->bound, now_m, axes);
        move_inside(&s->bound, before_m, axes);
    }
    for (unsigned i = 0; i < axes; i++)
        velocity_m_s[i] = (now_m[i] - before_m[i]) * (1e6 / (double)step_us);
}

/* Return the largest error of the force where the applied force differs too. */
static double largest_error(const hn_sender *s, const double spring_n[], const double damper_n[],
                            const double differs_n[])
{
    unsigned axes = s->law.axes;
    double size_n = hn_norm(differs_n, axes), error_n = hn_norm(spring_n, axes) + hn_norm(damper_n, axes);
    if (axes == 1) { /* a contact pushes harder where the tool is deeper or faster, so both differ in one direction */
        double both_n = spring_n[0] + damper_n[0];
        double most_n = fmax(fmax(0.0, spring_n[0]), fmax(damper_n[0], both_n));
        double least_n = fmin(fmin(0.0, spring_n[0]), fmin(damper_n[0], both_n));
        error_n = fmax(error_n, fmax(most_n - differs_n[0], differs_n[0] - least_n));
    } else {
        error_n += size_n;
    }
    return error_n + s->law.multiplier * s->law.weber_fraction * size_n;
}

/* Return whether the force on the line may differ from the true one by more than the positions' share. */
static bool is_too_far(hn_sender *s, int64_t t_us, const double x[], const double followed_m[], const double velocity[],
                       double applied_n, bool outside, const double *differs_n)
{
    const hn_bound *bound = &s->bound;
    unsigned axes = s->law.axes;
    int64_t step_us = newest_step_us(s);
    double stiffness = bound->stiffness_n_m, damping = bound->damping_n_s_m, a = bound->stiffening_per_m;
    double changed_n = 0.0, threshold_n = hn_threshold(&s->law, applied_n);
    hn_vector now, before, spring_n, damper_n = {0};
    hn_line_at(&s->line, t_us, axes, now);
    hn_line_at(&s->line, t_us - step_us, axes, before);
    double moved_m = apart(now, before, axes);
    if (damping != 0.0) {
        followed_velocity(s, t_us, step_us, outside, now);
        for (unsigned i = 0; i < axes; i++)
            damper_n[i] = (velocity[i] - now[i]) * damping;
        followed_velocity(s, t_us - step_us, step_us, outside, before);
        changed_n = damping * apart(now, before, axes);
    }
    if (a != 0.0) /* the springs' part of the force may be larger than the force by that of the dampers */
        stiffness += a * (applied_n + changed_n + 2.0 * threshold_n + damping * hn_norm(velocity, axes));
    s->stiffest_n_m = fmax(s->stiffest_n_m, stiffness);
    if (outside)
        stiffness = s->stiffest_n_m != 0.0 ? s->stiffest_n_m : HN_UNKNOWN_STIFFNESS;
    else if (a != 0.0) /* over a distance d, the stiffness grows by exp(a d) */
        stiffness *= exp(fmin(a * (apart(x, followed_m, axes) + moved_m), 50.0));
    for (unsigned i = 0; i < axes; i++)
        spring_n[i] = (x[i] - followed_m[i]) * stiffness;
    double error_n = differs_n != NULL ? largest_error(s, spring_n, damper_n, differs_n)
                                       : hn_norm(spring_n, axes) + hn_norm(damper_n, axes);
    /* The difference belongs to the force after the slave's answer, which is within the codec's threshold of this. */
    double least_n = applied_n - (changed_n + stiffness * moved_m) - 2.0 * (1.0 - s->share) * threshold_n;
    return !(error_n <= s->share * hn_threshold(&s->law, fmax(least_n, 0.0)));
}

/* Return whether a position must be sent. */
static bool is_due(hn_sender *s, int64_t t_us, const double x[], const double velocity[], double applied_n,
                   hn_difference *difference, void *context)
{
    const hn_bound *bound = &s->bound;
    hn_vector followed_m, differs_n;
    if (!s->has_line || t_us < s->line.t_us || !s->has_bound || t_us - s->line.t_us >= HN_LONGEST_SILENCE_US)
        return true;
    hn_line_at(&s->line, t_us, s->law.axes, followed_m);
    bool outside = !is_inside(bound, x, s->law.axes);
    if (outside && !s->left) {
        s->left = true;
        return true;
    }
    if (!outside)
        move_inside(bound, followed_m, s->law.axes);
    bool differs = difference(context, followed_m, differs_n);
    if (!outside && bound->stiffness_n_m == 0.0 && bound->damping_n_s_m == 0.0 && bound->stiffening_per_m == 0.0 &&
        !differs)
        return false;
    return is_too_far(s, t_us, x, followed_m, velocity, applied_n, outside, differs ? differs_n : NULL);
}

void hn_sender_init(hn_sender *s, const hn_settings *law, double share)
{
    memset(s, 0, sizeof *s);
    s->law = *law;
    s->share = share;
}

void hn_sender_bound(hn_sender *s, bool has, const hn_bound *bound)
{
    s->has_bound = has;
    s->left = false;
    if (!has)
        return;
    s->bound = *bound;
    s->stiffest_n_m = fmax(s->stiffest_n_m, bound->stiffness_n_m);
}

size_t hn_sender_position(hn_sender *s, int64_t t_us, const double position_m[], double applied_n, bool wanted,
                          hn_difference *difference, void *context, uint8_t *payload)
{
    hn_vector x, velocity = {0};
    for (unsigned i = 0; i < s->law.axes; i++)
        x[i] = (double)(float)position_m[i];
    if (s->count > 0 && t_us <= sample(s, 0)->t_us) /* the clock went back */
        s->count = 0;
    newest_velocity(s, t_us, x, velocity);
    add_sample(s, t_us, x);
    if (!is_due(s, t_us, x, velocity, applied_n, difference, context) && !wanted)
        return 0;
    promise(s, t_us, x, velocity);
    return write_promise(&s->line, s->law.axes, payload);
}

bool hn_sender_place(const hn_sender *s, int64_t t_us, double place_m[])
{
    if (!s->has_line)
        return false;
    hn_copy(place_m, s->line.position_m, s->law.axes);
    if (s->has_bound) {
        hn_line_at(&s->line, t_us, s->law.axes, place_m);
        move_inside(&s->bound, place_m, s->law.axes);
    }
    return true;
}
