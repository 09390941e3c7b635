/* The velocity-adaptive deadband. */
#include "twin.h"

size_t velocity_adaptive(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                         double weber_fraction, double floor_n, double gain_s_m, double largest_fraction,
                         double time_constant_s, double *decoded, int64_t *sent)
{
    size_t count = 0;
    double reference = 0.0, velocity = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        if (i) {
            const double elapsed_s = (double)(t_us[i] - t_us[i - 1]) * 1e-6;
            velocity = (time_constant_s * velocity + (positions[i] - positions[i - 1])) / (time_constant_s + elapsed_s);
        }
        const double grown = smaller(weber_fraction + gain_s_m * fabs(velocity), largest_fraction);
        if (count == 0 || fabs(x - reference) > jnd_n(reference, grown, floor_n)) {
            reference = (double)(float)x;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
