/* Adaptive prediction, jumps not bounded, stimuli in range. The same as hapticnet to the bit. */
#include "trend.h"

size_t adaptive_predictive(const double *stimuli, size_t samples, const int64_t *t_us, const double *positions,
                           double weber_fraction, double floor_n, double horizon_us, double window_us, double *decoded,
                           int64_t *sent)
{
    struct trust trust = {.in = {0.5, 0.5, 0.0}};
    struct trend causes = {0.0, 0.0, 0.0};
    size_t count = 0;
    int64_t start_us = 0;
    double value = 0.0, travel = 0.0, sent_for = 0.0;
    for (size_t i = 0; i < samples; i++) {
        const double x = stimuli[i], s = within(larger(0.0, (double)(t_us[i] - start_us) / horizon_us), 1.0);
        const double share = s * (2.0 - s);
        double point = value + travel * share;
        const double error = fabs(x - point), reach = jnd_n(point, weber_fraction, floor_n);
        if (count == 0 || error > reach) {
            if (count && error <= 3.0 * reach) {
                const double scale = 1.0 / jnd_n(sent_for, weber_fraction, floor_n), made = share * scale;
                const struct trend predicted = {made * causes.short_slope, made * causes.long_slope,
                                               scale * causes.level};
                if (share > 0.0)
                    learn(&trust, predicted, scale * (x - sent_for));
            }
            const double threshold = jnd_n(x, weber_fraction, floor_n);
            causes = trend(t_us, stimuli, i, 2.0 * threshold, window_us);
            causes.short_slope *= 0.5 * horizon_us;
            causes.long_slope *= 0.5 * horizon_us;
            const double wanted = predicted_change(trust.in, causes, threshold);
            const double offset = within(trust.in.level * causes.level, 0.9 * threshold / (1.0 + weber_fraction));
            value = (double)(float)(x + offset);
            const double around = jnd_n(value, weber_fraction, floor_n);
            travel = (double)(_Float16)within(wanted / around, 1024.0) * around;
            start_us = t_us[i];
            sent_for = x;
            sent[count++] = (int64_t)i;
            point = value;
        }
        decoded[i] = point;
    }
    return count;
}
