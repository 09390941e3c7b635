/* Level crossing. Levels are those from zero on, edges the ends of their cells. */
#include "twin.h"

size_t level_crossing(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                      double weber_fraction, double floor_n, const double *levels, const double *edges,
                      size_t count_levels, double *decoded, int64_t *sent)
{
    size_t count = 0;
    double low = INFINITY, high = -INFINITY, reference = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (!(x >= low && x <= high)) {
            const double size = fabs(x);
            size_t first = 0, last = count_levels - 1;
            while (first < last) {
                const size_t middle = (first + last) / 2;
                if (edges[middle] < size)
                    first = middle + 1;
                else
                    last = middle;
            }
            reference = copysign(levels[first], x);
            const double threshold = jnd_n(reference, weber_fraction, floor_n);
            low = reference - threshold;
            high = reference + threshold;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
