/* The merging deadband. */
#include "twin.h"

size_t merging(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
               double weber_fraction, double floor_n, int64_t window_us, double *decoded, int64_t *sent)
{
    size_t count = 0;
    int64_t end_us = INT64_MIN;
    double low = INFINITY, high = -INFINITY, reference = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (t_us[i] >= end_us && !(x >= low && x <= high)) {
            reference = (double)(float)x;
            const double threshold = jnd_n(reference, weber_fraction, floor_n);
            low = reference - threshold;
            high = reference + threshold;
            end_us = t_us[i] + window_us;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
