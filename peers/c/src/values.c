#include "values.h"

#include <math.h>
#include <string.h>

void hn_copy(double to[], const double from[], unsigned axes)
{
    memcpy(to, from, axes * sizeof *to);
}

double hn_inner(const double x[], const double y[], unsigned axes)
{
    double total = x[0] * y[0];
    for (unsigned i = 1; i < axes; i++)
        total += x[i] * y[i];
    return total;
}

void hn_read_halves(const uint8_t *at, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        x[i] = hn_read_half(at + 2 * i);
}

bool hn_read_singles(const uint8_t *at, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        x[i] = hn_read_single(at + 4 * i);
    return hn_in_range(x, axes);
}

bool hn_read_doubles(const uint8_t *at, double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        x[i] = hn_read_double(at + 8 * i);
    return hn_in_range(x, axes);
}

static bool read_counts(const uint8_t *at, double x[], unsigned axes, double step)
{
    int least = 0;
    for (unsigned i = 0; i < axes; i++) {
        int count = hn_read_count(at + 2 * i);
        least = count < least ? count : least;
        x[i] = count * step;
    }
    return least >= -HN_LARGEST_COUNT;
}

bool hn_read_value(const hn_decoder *d, const uint8_t *at, size_t size, double value[])
{
    unsigned axes = d->settings.axes;
    if (size == 2 * axes && d->step_n > 0.0)
        return read_counts(at, value, axes, d->step_n);
    if (size == 4 * axes)
        return hn_read_singles(at, value, axes);
    return size == 8 * axes && d->settings.codec != HN_CODEC_RAW && hn_read_doubles(at, value, axes);
}

/* Lines: a value and a slope. */

bool hn_read_line(const hn_decoder *d, const uint8_t *at, size_t size, double value[], double slope[])
{
    unsigned axes = d->settings.axes;
    if (size == 4 * axes) {
        double unit = (d->step_n * 1000.0) / d->horizon_ms;
        EACH_AXIS(i) slope[i] = hn_read_count(at + 2 * (axes + i)) * unit;
        return hn_read_value(d, at, 2 * axes, value);
    }
    return (size == 8 * axes || size == 12 * axes) && hn_read_value(d, at, size - 4 * axes, value) &&
           hn_read_singles(at + size - 4 * axes, slope, axes);
}

void hn_on_line(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    double elapsed_us = fmin((double)(t_us - d->t_us), d->horizon_ms * 1000.0);
    EACH_AXIS(i)
    {
        double end_n = d->value[i] + (d->slope[i] * 1e-6) * elapsed_us;
        stimulus_n[i] = elapsed_us > 0.0 ? hn_limit(end_n) : d->value[i];
    }
}
