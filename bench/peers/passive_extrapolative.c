/* The limit of a whole-array passive extrapolation: the same work as hapticnet's encoder in a plain loop, one axis,
 * float32 payloads. Writes what is applied at every sample and the index of every transmitted one; returns how many. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

size_t passive_extrapolative(const double *stimuli, size_t samples, const double *positions, double weber_fraction,
                             double floor_n, double *decoded, int64_t *sent)
{
    size_t count = 0;
    double low = INFINITY, high = -INFINITY, value = 0.0, threshold = 0.0, along = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (!(x >= low && x <= high)) {
            value = (double)(float)x;
            const double jnd = weber_fraction * fabs(value);
            threshold = jnd > floor_n ? jnd : floor_n;
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
