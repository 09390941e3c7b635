#include "hold.h"

#include <math.h>
#include <string.h>

double hn_norm(const double x[], unsigned axes)
{
    double total = 0.0;
    if (axes == 1)
        return fabs(x[0]);
    for (unsigned i = 0; i < axes; i++)
        total += x[i] * x[i];
    return sqrt(total);
}

/* Note that this share of the stimulus is applied now, and may rise only from there. */
static void note_share(hn_hold *h, double share)
{
    hn_vector applied_n;
    for (unsigned i = 0; i < h->axes; i++)
        applied_n[i] = h->stimulus_n[i] * share;
    h->share = share;
    h->applied_n = hn_norm(applied_n, h->axes);
    h->whole = false;
    h->elapsed_us = 0;
}

/* Ages are sums of steps forward: a clock that goes back makes no stimulus younger. */
static void grow_older(hn_hold *h, int64_t now_us)
{
    if (now_us > h->now_us) {
        int64_t elapsed_us = now_us - h->now_us;
        h->age_us += elapsed_us;
        h->elapsed_us += elapsed_us;
        if (h->elapsed_us > HN_LONGEST_STEP_US) /* a pause counts no more than one step */
            h->elapsed_us = HN_LONGEST_STEP_US;
    }
    h->now_us = now_us;
    int64_t left_us = HN_DECAY_US - (h->age_us - HN_AGE_LIMIT_US);
    if (left_us < HN_DECAY_US && !h->kept)
        note_share(h, left_us > 0 ? fmin(h->share, (double)left_us / HN_DECAY_US) : 0.0);
}

static void rise(hn_hold *h)
{
    double wanted_n = hn_norm(h->stimulus_n, h->axes);
    double highest_n = h->applied_n + (HN_RISE_N_PER_S * 1e-6) * (double)h->elapsed_us;
    h->elapsed_us = 0;
    h->whole = wanted_n <= highest_n;
    h->share = h->whole ? 1.0 : highest_n / wanted_n;
    h->applied_n = fmin(wanted_n, highest_n);
}

void hn_hold_init(hn_hold *h, unsigned axes)
{
    memset(h, 0, sizeof *h);
    h->axes = axes;
    h->age_us = HN_AGE_LIMIT_US + HN_DECAY_US + 1;
}

void hn_hold_receive(hn_hold *h, const double stimulus_n[], int64_t now_us)
{
    grow_older(h, now_us);
    if (h->starts) {
        h->starts = false;
        note_share(h, h->share);
    }
    memcpy(h->stimulus_n, stimulus_n, h->axes * sizeof *stimulus_n);
    h->age_us = 0;
}

void hn_hold_follow(hn_hold *h, const double stimulus_n[], int64_t now_us)
{
    memcpy(h->stimulus_n, stimulus_n, h->axes * sizeof *stimulus_n);
    grow_older(h, now_us);
}

void hn_hold_confirm(hn_hold *h, int64_t now_us)
{
    grow_older(h, now_us);
    h->age_us = 0;
}

void hn_hold_restart(hn_hold *h)
{
    h->starts = true;
}

void hn_hold_release(hn_hold *h)
{
    note_share(h, 0.0);
}

void hn_hold_value(hn_hold *h, double force_n[], int64_t now_us)
{
    if (now_us != h->now_us || h->age_us > HN_AGE_LIMIT_US)
        grow_older(h, now_us);
    if (!h->whole && (h->kept || h->age_us <= HN_AGE_LIMIT_US))
        rise(h);
    for (unsigned i = 0; i < h->axes; i++) {
        if (h->whole)
            force_n[i] = h->stimulus_n[i];
        else
            force_n[i] = h->share > 0.0 ? h->stimulus_n[i] * h->share : 0.0;
    }
}
