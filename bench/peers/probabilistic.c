/* The limit of a whole-array deadband that repeats itself: the same work as hapticnet's encoder in a plain loop, one
 * axis, float32 payloads. Writes what the receiver holds at every sample and the index of every transmitted one;
 * returns how many. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

enum { STATES = 16 };

size_t probabilistic(const double *stimuli, size_t samples, double weber_fraction, double floor_n, double loss,
                     double limit, double *decoded, int64_t *sent)
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
            const double jnd = weber_fraction * fabs(reference);
            references[count % STATES] = reference;
            thresholds[count % STATES] = jnd > floor_n ? jnd : floor_n;
            sent[count++] = (int64_t)i;
        }
        decoded[i] = reference;
    }
    return count;
}
