/* The trend of the newest samples, and the regression that learns how much of it to use. No product may be contracted with
 * a sum, so that the numbers are hapticnet's to the bit. */
#pragma GCC optimize("fp-contract=off")
#include "twin.h"

struct trend {
    double short_slope, long_slope, level;
};

struct trust {
    double aa, ab, ac, bb, bc, cc, a, b, c; /* the normal equations */
    struct trend in;                        /* their solution */
};

static double within(double x, double limit)
{
    return larger(-limit, smaller(x, limit));
}

static struct trend trend(const int64_t *t_us, const double *stimuli, size_t newest, double band, double window_us)
{
    if (newest)
        window_us = larger(window_us, 3.0 * (double)(t_us[newest] - t_us[newest - 1]));
    const double x = stimuli[newest], short_us = 0.3 * window_us;
    size_t count = 0;
    double weights = 1.0, moment = 0.0, spread = 0.0, product = 0.0, rise = 0.0, slope = 0.0;
    double short_spread = 0.0, short_product = 0.0;
    const size_t oldest = newest > 63 ? newest - 63 : 0;
    for (size_t k = newest; k-- > oldest;) {
        const double age_us = (double)(t_us[newest] - t_us[k]), change = x - stimuli[k];
        if (age_us >= window_us)
            break;
        if (age_us <= 0.0)
            continue;
        if (count && !(fabs(change - slope * age_us) <= band))
            break;
        count++;
        const double weight = 1.0 - age_us / window_us, weighted_us = weight * age_us;
        weights += weight;
        moment += weighted_us;
        spread += weighted_us * age_us;
        product += weighted_us * change;
        rise += weight * change;
        slope = product / spread;
        if (age_us < short_us) {
            const double short_weighted_us = (1.0 - age_us / short_us) * age_us;
            short_spread += short_weighted_us * age_us;
            short_product += short_weighted_us * change;
        }
    }
    if (count < 2)
        return (struct trend){0.0, 0.0, 0.0};
    const double free_slope = (weights * product - moment * rise) / (weights * spread - moment * moment);
    return (struct trend){short_spread > 0.0 ? short_product / short_spread : slope, slope,
                          (free_slope * moment - rise) / weights};
}

static void learn(struct trust *trust, struct trend predicted, double moved)
{
    const double p = predicted.short_slope, q = predicted.long_slope, r = predicted.level, m = moved;
    if (!(p * p + q * q + r * r + m * m <= 1e6))
        return;
    const double weight = 1.0 / (1.0 + 0.05 * (p * p + 2.0 * (p * q) + q * q));
    trust->aa = 0.99 * trust->aa + weight * (p * p);
    trust->ab = 0.99 * trust->ab + weight * (p * q);
    trust->ac = 0.99 * trust->ac + weight * (p * r);
    trust->bb = 0.99 * trust->bb + weight * (q * q);
    trust->bc = 0.99 * trust->bc + weight * (q * r);
    trust->cc = 0.99 * trust->cc + weight * (r * r);
    trust->a = 0.99 * trust->a + weight * (p * m);
    trust->b = 0.99 * trust->b + weight * (q * m);
    trust->c = 0.99 * trust->c + weight * (r * m);
    const double aa = trust->aa + 0.5, ab = trust->ab, ac = trust->ac;
    const double factor_b = ab / aa, factor_c = ac / aa;
    const double bb = trust->bb + (0.5 - factor_b * ab), bc = trust->bc - factor_b * ac, factor = bc / bb;
    double a = trust->a + 0.25, b = trust->b + 0.25 - factor_b * a, c = trust->c;
    c = (c - factor_c * a - factor * b) / (trust->cc + 0.5 - factor_c * ac - factor * bc);
    b = (b - bc * c) / bb;
    a = (a - ab * b - ac * c) / aa;
    trust->in = a + b > 0.0 ? (struct trend){a, b, c} : (struct trend){0.0, 0.0, c};
}

static double predicted_change(struct trend trusted, struct trend causes, double threshold)
{
    double a = trusted.short_slope, b = trusted.long_slope;
    const double both = fabs(causes.short_slope + causes.long_slope);
    if (a + b > 1.0 && both > 0.0) {
        const double limit = smaller(1.0, (1.0 + 0.55 * sqrt(2.0 * threshold / both)) / (a + b));
        a *= limit;
        b *= limit;
    }
    return a * causes.short_slope + b * causes.long_slope;
}
