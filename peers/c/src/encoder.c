#include "encoder.h"

#include <math.h>
#include <string.h>

#include "hold.h"

static double distance(const double x[], const double y[], unsigned axes)
{
    hn_vector apart;
    for (unsigned i = 0; i < axes; i++)
        apart[i] = x[i] - y[i];
    return hn_norm(apart, axes);
}

void hn_encoder_init(hn_encoder *e, const hn_settings *settings)
{
    memset(e, 0, sizeof *e);
    e->settings = *settings;
    hn_get(settings, "step_n", &e->step_n);
    hn_encoder_refresh(e);
}

void hn_encoder_refresh(hn_encoder *e)
{
    e->threshold_n = -1.0;
}

/* Round a stimulus to counts; return whether all are in range. */
static bool count(const hn_encoder *e, const double x[], double value[])
{
    bool good = e->step_n > 0.0;
    for (unsigned i = 0; i < e->settings.axes && good; i++) {
        double counts = rint(x[i] / e->step_n);
        good = fabs(counts) <= HN_LARGEST_COUNT;
        value[i] = counts * e->step_n;
    }
    return good;
}

/* Whether the dead zone around a value, whose size it notes, has the stimulus. */
static bool is_close(hn_encoder *e, const double x[], const double value[])
{
    e->threshold_n = hn_threshold(&e->settings, hn_norm(value, e->settings.axes));
    return e->settings.codec == HN_CODEC_RAW || distance(x, value, e->settings.axes) <= e->threshold_n;
}

size_t hn_encode(hn_encoder *e, const double stimulus_n[], uint8_t *payload)
{
    unsigned axes = e->settings.axes;
    hn_vector value;
    size_t form = 2; /* the first form of 2, 4 and 8 bytes an axis that is close enough */
    if (e->settings.codec != HN_CODEC_RAW && distance(stimulus_n, e->held_n, axes) <= e->threshold_n)
        return 0;
    if (!count(e, stimulus_n, value) || !is_close(e, stimulus_n, value)) {
        form = 4;
        for (unsigned i = 0; i < axes; i++)
            value[i] = (double)(float)stimulus_n[i];
        if (!is_close(e, stimulus_n, value)) {
            form = 8;
            memcpy(value, stimulus_n, axes * sizeof *value);
            is_close(e, stimulus_n, value);
        }
    }
    for (unsigned i = 0; i < axes; i++) {
        if (form == 2)
            hn_store_count(payload + 2 * i, (int)rint(value[i] / e->step_n));
        else if (form == 4)
            hn_store_single(payload + 4 * i, value[i]);
        else
            hn_store_double(payload + 8 * i, value[i]);
    }
    memcpy(e->held_n, value, axes * sizeof *value);
    return form * axes;
}
