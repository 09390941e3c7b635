/* Passive interpolation. */
#include "twin.h"

size_t passive_interpolative(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                             double weber_fraction, double floor_n, double interval_us, double *decoded, int64_t *sent)
{
    size_t count = 0;
    int64_t start_us = 0;
    double low = INFINITY, high = -INFINITY, value = 0.0, origin = 0.0, ramp_us = 0.0, threshold = 0.0, along = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        double elapsed_us = (double)(t_us[i] - start_us);
        if (!(x >= low && x <= high)) {
            origin = count == 0 ? x : elapsed_us < ramp_us ? origin + elapsed_us / ramp_us * (value - origin) : value;
            ramp_us = count == 0 ? 0.0 : smaller(elapsed_us, interval_us);
            start_us = t_us[i];
            elapsed_us = 0.0;
            value = (double)(float)x;
            threshold = jnd_n(value, weber_fraction, floor_n);
            low = value - threshold;
            high = value + threshold;
            sent[count++] = (int64_t)i;
        }
        if (i && positions[i] != positions[i - 1])
            along = positions[i] > positions[i - 1] ? 1.0 : -1.0;
        const double base = elapsed_us < ramp_us ? origin + elapsed_us / ramp_us * (value - origin) : value;
        decoded[i] = along == 0.0 ? value : base + (threshold + larger((value - base) * along, 0.0)) * along;
    }
    return count;
}
