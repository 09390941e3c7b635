#include "repair.h"

#include <math.h>
#include <string.h>

#include "hold.h"
#include "messages.h"

void hn_repair_init(hn_repair *r, const hn_settings *settings, int64_t now_us)
{
    memset(r, 0, sizeof *r);
    r->settings = *settings;
    r->keepalive_us = HN_KEEPALIVE_US;
    r->spoke_us = now_us;
    r->overdue_us = r->timeout_us = HN_INITIAL_TIMEOUT_US;
    r->needed = 1;
    r->credit = HN_MOST_CREDIT;
}

/* Return a datagram without acknowledgement, 0 being the oldest. */
static const hn_sent *sent(const hn_repair *r, unsigned index)
{
    return &r->sent[(r->first + index) % HN_MOST_SENT];
}

static void forget_oldest(hn_repair *r)
{
    r->first = (r->first + 1) % HN_MOST_SENT;
    r->count--;
}

void hn_repair_sent(hn_repair *r, uint32_t kind, uint32_t sequence, const double before_n[], int64_t now_us)
{
    r->spoke_us = now_us;
    if (kind == HN_KEEPALIVE && r->share == 0.0) /* one is waited for only while there is loss */
        return;
    if (r->count == 0)
        r->since_us = now_us;
    if (r->count == HN_MOST_SENT)
        forget_oldest(r);
    hn_sent *newest = &r->sent[(r->first + r->count++) % HN_MOST_SENT];
    newest->sequence = sequence;
    newest->sent_us = now_us;
    memcpy(newest->before_n, before_n, r->settings.axes * sizeof *before_n);
}

static void measure(hn_repair *r, double round_trip_us)
{
    if (!r->measured) {
        r->measured = true;
        r->smoothed_us = round_trip_us;
        r->deviation_us = round_trip_us / 2.0;
    } else {
        r->deviation_us += (fabs(round_trip_us - r->smoothed_us) - r->deviation_us) / 4.0;
        r->smoothed_us += (round_trip_us - r->smoothed_us) / 8.0;
    }
    r->timeout_us = fmax(r->smoothed_us + fmax(4.0 * r->deviation_us, HN_GRANULARITY_US), HN_SHORTEST_TIMEOUT_US);
    r->overdue_us = r->timeout_us;
}

void hn_repair_acknowledged(hn_repair *r, uint32_t sequence, int64_t now_us)
{
    int64_t sent_us = 0;
    if (r->count == 0 || hn_distance(sequence, sent(r, 0)->sequence) < 0 ||
        hn_distance(sequence, sent(r, r->count - 1)->sequence) > 0)
        return; /* it was never sent, or is known */
    while (r->count > 0 && hn_distance(sequence, sent(r, 0)->sequence) >= 0) {
        sent_us = sent(r, 0)->sent_us;
        forget_oldest(r);
    }
    if (r->count > 0 && sent(r, 0)->sent_us > r->since_us)
        r->since_us = sent(r, 0)->sent_us;
    measure(r, now_us > sent_us ? (double)(now_us - sent_us) : 0.0);
}

/* Return how many evenly spaced datagrams a window needs, so that all are lost no more often than HN_SILENCES_PER_S. */
static unsigned datagrams_needed(const hn_repair *r, double window_us)
{
    double starts_per_s = r->share * (1.0 - r->again) * 1e6 / window_us;
    for (unsigned datagrams = 1; datagrams < HN_MOST_DATAGRAMS; datagrams++)
        if (datagrams * starts_per_s * pow(r->again, datagrams - 1.0) <= HN_SILENCES_PER_S)
            return datagrams;
    return HN_MOST_DATAGRAMS;
}

/* Choose the longest silence that leaves enough chances for a datagram within the age limit. */
static void pace(hn_repair *r)
{
    double most_us = HN_STALE_AFTER_US;
    double window_us = fmax(most_us - HN_SCHEDULING_US - 4.0 * r->deviation_us, 0.5 * most_us);
    r->keepalive_us = HN_KEEPALIVE_US;
    r->needed = 1;
    if (r->share == 0.0)
        return;
    r->needed = datagrams_needed(r, window_us);
    for (; r->keepalive_us > HN_SHORTEST_KEEPALIVE_US; r->keepalive_us -= HN_PACE_STEP_US) {
        double spacing_us = (double)r->keepalive_us + r->late_us, chances = window_us / spacing_us;
        double left_us = window_us - spacing_us - r->overdue_us;
        if (left_us > 0.0) { /* the first loss is noticed in time to send more often */
            chances = 1.0 + r->overdue_us / spacing_us;
            chances += left_us / (HN_SHORTEST_WAIT_US + 2.0 * r->late_us);
        }
        if (chances >= r->needed)
            return;
    }
}

void hn_repair_reported(hn_repair *r, double share, double again, int64_t now_us)
{
    r->reported_us = now_us;
    r->share = share;
    r->again = again;
    pace(r);
}

/* Return how far a stimulus is from one that is held, in just-noticeable differences. */
static double miss(const hn_repair *r, const double x[], const double before_n[])
{
    double jnd_n = fmax(r->settings.weber_fraction * hn_norm(before_n, r->settings.axes), r->settings.floor_n);
    hn_vector apart;
    for (unsigned i = 0; i < r->settings.axes; i++)
        apart[i] = x[i] - before_n[i];
    double away_n = hn_norm(apart, r->settings.axes);
    return jnd_n > 0.0 ? away_n / jnd_n : away_n > 0.0 ? INFINITY : 0.0;
}

/* Return how long to wait after the newest datagram before the stimulus is repeated; infinity if it need not be. If the
 * newest n datagrams are all lost, the master holds what was there before the first of these. */
static double repeat_after_us(const hn_repair *r, const double x[])
{
    double all_lost = r->share, doubt = 0.0, newest_miss = 0.0, last_miss = 0.0;
    unsigned left = r->count;
    for (; left > 0 && doubt + all_lost > HN_DOUBT_LIMIT; left--) {
        last_miss = miss(r, x, sent(r, left - 1)->before_n);
        if (last_miss > 1.0) {
            doubt += all_lost * (1.0 - r->again);
            newest_miss = newest_miss > 0.0 ? newest_miss : last_miss;
        }
        all_lost *= r->again;
    }
    if (left == 0 && last_miss > 1.0) /* nothing without acknowledgement has arrived */
        doubt += all_lost;
    return doubt <= HN_DOUBT_LIMIT ? INFINITY : fmax(HN_SHORTEST_WAIT_US, HN_LONGEST_WAIT_US / newest_miss);
}

static bool keeps_alive(hn_repair *r, int64_t silent_us)
{
    if (silent_us < r->keepalive_us)
        return false;
    /* Datagrams are sent when positions arrive, and these arrive unevenly. */
    int64_t late_us = silent_us - r->keepalive_us;
    r->late_us += ((double)(late_us < HN_KEEPALIVE_US ? late_us : HN_KEEPALIVE_US) - r->late_us) / 32.0;
    return true;
}

/* Whether a datagram is known to be lost, and too few were sent since to be sure that one arrived. */
static bool may_be_silent(const hn_repair *r, int64_t now_us)
{
    if ((double)(now_us - sent(r, 0)->sent_us) <= r->overdue_us)
        return false;
    for (unsigned since = 0; since < r->count && since < r->needed; since++)
        if ((double)(now_us - sent(r, r->count - 1 - since)->sent_us) > r->overdue_us)
            return true;
    return false;
}

bool hn_repair_is_due(hn_repair *r, const double stimulus_n[], int64_t now_us)
{
    int64_t waited_us = now_us - r->since_us, silent_us = now_us - r->spoke_us;
    if (r->count == 0)
        return false;
    /* If the clock went back, the elapsed time is unknown: better once too often. */
    if (waited_us < 0 || (double)waited_us > r->timeout_us) {
        r->since_us = now_us;
        r->timeout_us = fmax(r->timeout_us, fmin(2.0 * r->timeout_us, HN_LONGEST_TIMEOUT_US));
        return true;
    }
    if (r->share == 0.0)
        return false;
    if (now_us - r->reported_us > HN_REPORT_LASTS_US) {
        hn_repair_reported(r, 0.0, 0.0, now_us);
        return false;
    }
    r->credit = fmin(r->credit + HN_REPEATS_PER_POSITION, HN_MOST_CREDIT);
    if (silent_us < HN_SHORTEST_WAIT_US)
        return false;
    if (!keeps_alive(r, silent_us) && !may_be_silent(r, now_us) &&
        (r->credit < 1.0 || (double)silent_us < repeat_after_us(r, stimulus_n)))
        return false;
    r->credit = fmax(r->credit - 1.0, 0.0);
    return true;
}

bool hn_keepalive_is_due(hn_repair *r, int64_t now_us)
{
    int64_t silent_us = now_us - r->spoke_us;
    return silent_us < 0 || keeps_alive(r, silent_us); /* a clock that went back must not silence the slave */
}
