/* The limit of a whole-array deadband: the same work as hapticnet's encoder in a plain loop, one axis.
 * Writes what the receiver holds at every sample and the index of every transmitted one; returns how many. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

size_t deadband(const double *stimuli, size_t samples, double weber_fraction, double floor_n, double multiplier,
                double *decoded, int64_t *sent)
{
    size_t count = 0;
    double low = INFINITY, high = -INFINITY, reference = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (!(x >= low && x <= high)) {
            reference = (double)(float)x;
            const double jnd = weber_fraction * fabs(reference);
            const double threshold = multiplier * (jnd > floor_n ? jnd : floor_n);
            low = reference - threshold;
            high = reference + threshold;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
