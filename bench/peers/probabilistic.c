/* The deadband that repeats itself. */
#include "twin.h"

enum { STATES = 16 };

size_t probabilistic(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                     double weber_fraction, double floor_n, double loss, double limit, double *decoded, int64_t *sent)
{
    size_t count = 0;
    double references[STATES], thresholds[STATES], held[STATES], older[STATES];
    for (size_t age = 0; age < STATES; age++) {
        held[age] = age ? held[age - 1] * loss : 1.0 - loss;
        older[age] = age ? older[age - 1] * loss : loss;
    }
    double reference = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i];
        int silent = 0;
        double doubt = 0.0;
        for (size_t age = 0; age < STATES && age < count; age++) {
            const size_t place = (count - 1 - age) % STATES;
            if (fabs(x - references[place]) > thresholds[place]) {
                if (age == 0)
                    break;
                doubt += held[age];
            }
            if (doubt + older[age] <= limit) {
                silent = 1;
                break;
            }
            if (doubt > limit)
                break;
        }
        if (!silent) {
            reference = (double)(float)x;
            references[count % STATES] = reference;
            thresholds[count % STATES] = jnd_n(reference, weber_fraction, floor_n);
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
