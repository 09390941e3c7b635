/* The deadband. */
#include "twin.h"

size_t deadband(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                double weber_fraction, double floor_n, double multiplier, double *decoded, int64_t *sent)
{
    size_t count = 0;
    double low = INFINITY, high = -INFINITY, reference = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (!(x >= low && x <= high)) {
            reference = (double)(float)x;
            const double threshold = multiplier * jnd_n(reference, weber_fraction, floor_n);
            low = reference - threshold;
            high = reference + threshold;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
