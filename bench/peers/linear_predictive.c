/* Linear prediction, for lines in range. */
#include "twin.h"

static double slope_n_per_s(const int64_t *t_us, const double *stimuli, size_t first, size_t newest)
{
    const int64_t count = (int64_t)(newest + 1 - first);
    int64_t total = 0, squares = 0;
    for (size_t k = first; k <= newest; k++) {
        const int64_t apart = t_us[k] - t_us[newest];
        total += apart;
        squares += apart * apart;
    }
    const int64_t spread = count * squares - total * total;
    if (spread == 0)
        return 0.0;
    double product = 0.0;
    for (size_t k = first; k <= newest; k++)
        product += (double)(count * (t_us[k] - t_us[newest]) - total) * (stimuli[k] - stimuli[newest]);
    return 1e6 * product / (double)spread;
}

size_t linear_predictive(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                         double weber_fraction, double floor_n, size_t slope_samples, double horizon_us,
                         double *decoded, int64_t *sent)
{
    size_t count = 0, since = 0;
    int64_t start_us = 0;
    double value = 0.0, rate = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i], elapsed_us = (double)(t_us[i] - start_us);
        double point = value + rate * smaller(elapsed_us, horizon_us);
        const double error = fabs(x - point), threshold = jnd_n(point, weber_fraction, floor_n);
        if (count == 0 || error > threshold) {
            if (count && error > 3.0 * threshold)
                since = i;
            const size_t oldest = i + 1 > slope_samples ? i + 1 - slope_samples : 0;
            rate = (double)(float)slope_n_per_s(t_us, stimuli, oldest > since ? oldest : since, i) * 1e-6;
            point = value = (double)(float)x;
            start_us = t_us[i];
            sent[count++] = (int64_t)i;
        }
        decoded[i] = point;
    }
    return count;
}
