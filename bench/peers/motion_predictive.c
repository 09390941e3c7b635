/* Prediction by time and position, stimuli in range, every position known, windows of less than 64 samples. The same as
 * hapticnet to the bit. */
#include "trend.h"

enum { UNSENT = -1, HOLD, CURVE, SURFACE, COUPLED };
enum { KEPT = 64 };

struct rule {
    double weber, floor, horizon_us, window_us, stiffest;
};

struct line {
    int kind;
    int64_t t_us;
    double offset, travel, normal, stiffness, viscosity;
};

struct sample {
    size_t index;
    int64_t t_us;
    double x, position, velocity;
};

/* The recording, and the newest velocities, which it does not hold. */
struct past {
    const double *stimuli, *positions;
    const int64_t *t_us;
    double velocities[KEPT];
};

struct predictor {
    struct line line;
    struct sample drawn;
    struct trend causes;
    struct trust trust;
};

struct coupling {
    int has_anchor;
    struct sample anchor;
    double a, b, c, p, q; /* the normal equations */
    double stiffness, viscosity;
};

static double as_half(double x)
{
    return (double)(_Float16)x;
}

static double threshold(const struct rule *rule, double x)
{
    return jnd_n(x, rule->weber, rule->floor);
}

static double share_at(const struct rule *rule, const struct line *line, int64_t t_us)
{
    const double s = (double)(t_us - line->t_us) / rule->horizon_us;
    return s >= 1.0 ? 1.0 : s > 0.0 ? s * (2.0 - s) : 0.0;
}

static double line_at(const struct rule *rule, const struct line *line, const struct sample *at)
{
    if (line->kind == HOLD)
        return line->offset;
    if (line->kind == SURFACE) {
        const double normal = line->normal, x = line->offset + normal * at->position * normal, out = normal * x;
        return out < 0.0 ? x + -out / (normal * normal) * normal : x;
    }
    const double x = line->offset + share_at(rule, line, at->t_us) * line->travel;
    return line->kind == CURVE ? x : x + line->stiffness * at->position + line->viscosity * at->velocity;
}

static int follows(const struct rule *rule, const struct line *line, const struct sample *at)
{
    if (line->kind == UNSENT)
        return 0;
    const double applied = line_at(rule, line, at);
    return fabs(at->x - applied) <= threshold(rule, applied);
}

/* The line as the receiver gets it: float32 if the stimulus is then within the threshold, otherwise float64. */
static struct line checked(const struct rule *rule, struct line wanted, const struct sample *at)
{
    for (int is_wide = 0; is_wide <= 1; is_wide++) {
        struct line line = wanted;
        if (!is_wide)
            line.offset = (double)(float)wanted.offset;
        if (line.kind == CURVE) {
            const double around = threshold(rule, line.offset);
            line.travel = around > 0.0 ? as_half(within(wanted.travel / around, 1024.0)) * around : 0.0;
        }
        if (follows(rule, &line, at))
            return line;
    }
    return (struct line){.kind = HOLD, .t_us = at->t_us, .offset = at->x};
}

static struct line drawn_hold(const struct rule *rule, double value, const struct sample *at)
{
    return checked(rule, (struct line){.kind = HOLD, .t_us = at->t_us, .offset = value}, at);
}

static struct line drawn_surface(const struct rule *rule, const struct past *past, const struct sample *at,
                                 double learned)
{
    const double size = fabs(at->x), band = 2.0 * threshold(rule, at->x);
    if (!(size > 1e-100))
        return drawn_hold(rule, at->x, at);
    const double towards = at->x / size;
    double square = 0.0, product = 0.0;
    for (size_t k = at->index; k-- > 0;) {
        if ((at->t_us - past->t_us[k] > 15000 && at->index - k > 3) || past->stimuli[k] == 0.0)
            break;
        const double moved = towards * (past->positions[k] - at->position);
        const double change = towards * (past->stimuli[k] - at->x);
        if (square > 0.0 && !(fabs(change - product / square * moved) <= band))
            break;
        square += moved * moved;
        product += moved * change;
    }
    const double stiffness = square < 1e-9 ? learned : larger(0.0, product / square);
    const double normal = stiffness > 0.0 ? as_half(towards * sqrt(smaller(stiffness, rule->stiffest))) : 0.0;
    if (!(normal * normal > 0.0))
        return drawn_hold(rule, at->x, at);
    const double offset = at->x - normal * (normal * at->position);
    return checked(rule, (struct line){.kind = SURFACE, .t_us = at->t_us, .offset = offset, .normal = normal}, at);
}

static struct trend trend_beside(const struct rule *rule, const struct past *past, const struct sample *at,
                                 double stiffness, double viscosity)
{
    const double band = 2.0 * threshold(rule, at->x), half_us = 0.5 * rule->horizon_us;
    struct trend causes;
    if (stiffness == 0.0 && viscosity == 0.0) {
        causes = trend(past->t_us, past->stimuli, at->index, band, rule->window_us);
    } else {
        int64_t times_us[KEPT];
        double left[KEPT];
        const size_t count = at->index + 1 < KEPT ? at->index + 1 : KEPT;
        double window_us = rule->window_us;
        if (at->index)
            window_us = larger(window_us, 3.0 * (double)(at->t_us - past->t_us[at->index - 1]));
        size_t first = KEPT;
        for (size_t age = 0; age < count; age++) {
            const size_t index = at->index - age;
            if (age && (double)(at->t_us - past->t_us[index]) >= window_us)
                break;
            first--;
            times_us[first] = past->t_us[index];
            left[first] = past->stimuli[index] + stiffness * (at->position - past->positions[index]) +
                          viscosity * (at->velocity - past->velocities[index % KEPT]);
        }
        causes = trend(times_us + first, left + first, KEPT - 1 - first, band, rule->window_us);
    }
    return (struct trend){half_us * causes.short_slope, half_us * causes.long_slope, causes.level};
}

static struct line drawn_curve(const struct rule *rule, struct trend trusted, struct trend causes,
                               const struct sample *at, double stiffness, double viscosity)
{
    const double around = threshold(rule, at->x), room = 0.9 * around / (1.0 + rule->weber);
    const double by = causes.level * trusted.level, length = fabs(by);
    const double begin = at->x + (length > room ? room / length : 1.0) * by;
    struct line line = {.kind = CURVE, .t_us = at->t_us, .offset = begin};
    line.travel = predicted_change(trusted, causes, around);
    if (stiffness == 0.0 && viscosity == 0.0)
        return checked(rule, line, at);
    line.kind = COUPLED;
    line.offset = begin + -stiffness * at->position + -viscosity * at->velocity;
    line.travel = (double)(float)line.travel;
    line.stiffness = stiffness;
    line.viscosity = viscosity;
    return checked(rule, line, at);
}

static void redraw(const struct rule *rule, const struct past *past, struct predictor *by, const struct sample *at,
                   double stiffness, double viscosity)
{
    const struct line *line = &by->line;
    if (line->kind != UNSENT) {
        const double applied = line_at(rule, line, at), share = share_at(rule, line, at->t_us);
        if (fabs(at->x - applied) <= 3.0 * threshold(rule, applied) && share > 0.0) {
            const double change = at->x - by->drawn.x + -line->stiffness * (at->position - by->drawn.position) +
                                  -line->viscosity * (at->velocity - by->drawn.velocity);
            const double scale = 1.0 / threshold(rule, by->drawn.x), made = share * scale;
            const struct trend predicted = {made * by->causes.short_slope, made * by->causes.long_slope,
                                            scale * by->causes.level};
            learn(&by->trust, predicted, scale * change);
        }
    }
    by->causes = trend_beside(rule, past, at, stiffness, viscosity);
    by->line = drawn_curve(rule, by->trust.in, by->causes, at, stiffness, viscosity);
    by->drawn = *at;
}

static void solve(struct coupling *coupling)
{
    const double a = coupling->a + 3e-10, b = coupling->b, c = coupling->c + 1.3e-9, p = coupling->p, q = coupling->q;
    const double determinant = a * c - b * b;
    coupling->stiffness = determinant > 0.0 ? (c * p - b * q) / determinant : -1.0;
    coupling->viscosity = determinant > 0.0 ? (a * q - b * p) / determinant : -1.0;
    if (determinant > 0.0 && coupling->stiffness < 0.0) {
        coupling->stiffness = 0.0;
        coupling->viscosity = larger(0.0, q / c);
    } else if (coupling->viscosity < 0.0) {
        coupling->stiffness = larger(0.0, p / a);
        coupling->viscosity = 0.0;
    }
}

static void observe(const struct rule *rule, struct coupling *coupling, const struct sample *at)
{
    const int64_t apart_us = at->t_us - coupling->anchor.t_us;
    if (coupling->has_anchor && apart_us < 30000)
        return;
    if (coupling->has_anchor && (double)apart_us < 3e6) {
        const struct sample *from = &coupling->anchor;
        const double scale = 1.0 / threshold(rule, at->x), square = scale * scale;
        const double dx = at->position - from->position, dv = at->velocity - from->velocity, change = at->x - from->x;
        const double xx = square * (dx * dx), xv = square * (dx * dv), vv = square * (dv * dv);
        if (xx + vv <= 1e18 && square * (change * change) <= 1e6) {
            const double keep = 3e6 / (3e6 + (double)apart_us);
            coupling->a = keep * coupling->a + xx;
            coupling->b = keep * coupling->b + xv;
            coupling->c = keep * coupling->c + vv;
            coupling->p = keep * coupling->p + square * (dx * change);
            coupling->q = keep * coupling->q + square * (dv * change);
            solve(coupling);
        }
    }
    coupling->has_anchor = 1;
    coupling->anchor = *at;
}

size_t motion_predictive(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                         double weber_fraction, double floor_n, double horizon_us, double window_us, double stiffest,
                         double *decoded, int64_t *sent)
{
    const struct rule rule = {weber_fraction, floor_n, horizon_us, window_us, stiffest};
    struct past past = {.stimuli = stimuli, .positions = positions, .t_us = t_us};
    struct line line = {.kind = UNSENT}, hold = line, surface = line;
    struct predictor curve = {.line = line, .trust = {.in = {0.5, 0.5, 0.0}}}, coupled = curve;
    struct coupling coupling = {0};
    double of_surface = 0.0, of_coupled = 0.0, of_curve = 0.0, of_hold = 0.0, velocity = 0.0;
    size_t count = 0;
    for (size_t i = 0; i < samples; i++) {
        if (i)
            velocity = (positions[i] - positions[i - 1] + 0.005 * velocity) /
                       (0.005 + (double)(t_us[i] - t_us[i - 1]) * 1e-6);
        past.velocities[i % KEPT] = velocity;
        const struct sample at = {i, t_us[i], stimuli[i], positions[i], velocity};
        if (i % 2 == 0) {
            observe(&rule, &coupling, &at);
            if (!follows(&rule, &hold, &at)) {
                hold = drawn_hold(&rule, at.x, &at);
                of_hold += 1.0;
            }
            if (!follows(&rule, &surface, &at)) {
                surface = drawn_surface(&rule, &past, &at, coupling.stiffness);
                of_surface += 1.0;
            }
            if (!follows(&rule, &curve.line, &at)) {
                redraw(&rule, &past, &curve, &at, 0.0, 0.0);
                of_curve += 1.0;
            }
            if (!follows(&rule, &coupled.line, &at)) {
                redraw(&rule, &past, &coupled, &at, as_half(smaller(coupling.stiffness, stiffest)),
                       as_half(smaller(coupling.viscosity, 1000.0)));
                of_coupled += 1.0;
            }
        }
        if (!follows(&rule, &line, &at)) {
            const double fewest = smaller(smaller(of_surface, of_coupled), smaller(of_curve, of_hold));
            if (of_surface == fewest) {
                line = drawn_surface(&rule, &past, &at, coupling.stiffness);
            } else if (of_coupled == fewest) {
                const double stiffness = as_half(smaller(coupling.stiffness, stiffest));
                const double viscosity = as_half(smaller(coupling.viscosity, 1000.0));
                const struct trend causes = trend_beside(&rule, &past, &at, stiffness, viscosity);
                line = drawn_curve(&rule, coupled.trust.in, causes, &at, stiffness, viscosity);
            } else if (of_curve == fewest) {
                line = drawn_curve(&rule, curve.trust.in, trend_beside(&rule, &past, &at, 0.0, 0.0), &at, 0.0, 0.0);
            } else {
                line = drawn_hold(&rule, follows(&rule, &hold, &at) ? hold.offset : at.x, &at);
            }
            of_surface *= 0.98;
            of_coupled *= 0.98;
            of_curve *= 0.98;
            of_hold *= 0.98;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = line_at(&rule, &line, &at);
    }
    return count;
}
