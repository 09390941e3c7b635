/* Passive extrapolation. */
#include "twin.h"

size_t passive_extrapolative(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                             double weber_fraction, double floor_n, double *decoded, int64_t *sent)
{
    size_t count = 0;
    double low = INFINITY, high = -INFINITY, value = 0.0, threshold = 0.0, along = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (!(x >= low && x <= high)) {
            value = (double)(float)x;
            threshold = jnd_n(value, weber_fraction, floor_n);
            low = value - threshold;
            high = value + threshold;
            sent[count++] = (int64_t)i;
        }
        if (i && positions[i] != positions[i - 1])
            along = positions[i] > positions[i - 1] ? 1.0 : -1.0;
        decoded[i] = value + threshold * along;
    }
    return count;
}
