#include "arrivals.h"

#include <math.h>
#include <string.h>

#include "messages.h"

static uint32_t *word(hn_arrivals *a, uint32_t sequence)
{
    return &a->seen[sequence % HN_WINDOW / 32];
}

static uint32_t bit(uint32_t sequence)
{
    return UINT32_C(1) << sequence % 32;
}

/* Let `sequence` be the newest number and, of those below, only forget the ones that are `ahead` or less away. */
static void move_to(hn_arrivals *a, uint32_t sequence, int64_t ahead)
{
    if (ahead >= HN_WINDOW)
        memset(a->seen, 0, sizeof a->seen);
    else
        for (uint32_t i = 0; i < ahead; i++)
            *word(a, sequence - i) &= ~bit(sequence - i);
    *word(a, sequence) |= bit(sequence);
    a->newest = sequence;
    a->after_leap.is_set = false;
    a->behind_run = 0;
}

void hn_arrivals_init(hn_arrivals *a, uint32_t first, bool authentic)
{
    a->authentic = authentic;
    move_to(a, first, HN_WINDOW);
    a->behind = first;
}

static bool newest_was_wrong(hn_arrivals *a, uint32_t sequence, int64_t behind)
{
    if (a->authentic || behind <= HN_MISORDER)
        return false;
    a->behind_run = hn_distance(sequence, a->behind) > 0 ? a->behind_run + 1 : 1;
    a->behind = sequence;
    return a->behind_run >= HN_BEHIND_IN_A_ROW;
}

hn_arrival hn_arrive(hn_arrivals *a, uint32_t sequence)
{
    int64_t ahead = hn_distance(sequence, a->newest);
    if (0 < ahead && (a->authentic || ahead < HN_LEAP)) {
        move_to(a, sequence, ahead);
        return HN_NEW;
    }
    if (ahead <= 0 && (a->authentic || -HN_LEAP < ahead)) {
        if (-ahead < HN_WINDOW && *word(a, sequence) & bit(sequence))
            return HN_DUPLICATE;
        if (-ahead < HN_WINDOW)
            *word(a, sequence) |= bit(sequence);
        if (!newest_was_wrong(a, sequence, -ahead))
            return HN_LATE;
    } else if (!a->after_leap.is_set || a->after_leap.value != sequence) {
        a->after_leap = (hn_maybe){true, sequence + 1};
        return HN_ASTRAY;
    }
    move_to(a, sequence, HN_WINDOW);
    return HN_NEW;
}

enum { ALL_ARRIVED = (1 << HN_REORDERED) - 1 };

void hn_loss_init(hn_loss *l, uint32_t first)
{
    *l = (hn_loss){
        .newest = first,
        .arrived = ALL_ARRIVED,
        .count = HN_ASSUMED_ARRIVED,
        .before_next = HN_ASSUMED_LOST,
        .lost_again = 0.5 * HN_ASSUMED_LOST,
    };
}

/* Add the fate of the next datagram in order of sequence. */
static void add(hn_loss *l, bool lost)
{
    double keep = 1.0 - 1.0 / HN_LOSS_MEMORY, keep_loss = 1.0 - 1.0 / HN_REMEMBERED_LOSSES;
    l->count = l->count * keep + 1.0;
    l->lost = l->lost * keep + lost;
    if (l->was_lost) {
        l->before_next = l->before_next * keep_loss + 1.0;
        l->lost_again = l->lost_again * keep_loss + lost;
    }
    l->was_lost = lost;
}

void hn_loss_arrived(hn_loss *l, uint32_t sequence, bool is_new)
{
    int64_t ahead = hn_distance(sequence, l->newest);
    if (is_new && ahead <= 0) { /* the newest was wrong */
        l->newest = sequence;
        l->arrived = ALL_ARRIVED;
    } else if (ahead <= 0) {
        if (-ahead < HN_REORDERED)
            l->arrived |= 1u << -ahead;
    } else {
        l->newest = sequence;
        for (int64_t step = ahead < HN_LOSS_MEMORY ? ahead : HN_LOSS_MEMORY; step > 0; step--) {
            add(l, !(l->arrived >> (HN_REORDERED - 1)));
            l->arrived = (l->arrived << 1 | (step == 1)) & ALL_ARRIVED;
        }
    }
}

bool hn_loss_estimate(const hn_loss *l, uint32_t *share, uint32_t *again)
{
    *share = (uint32_t)rint(HN_REPORT_STEPS * l->lost / l->count);
    *again = (uint32_t)rint(HN_REPORT_STEPS * (l->lost_again / l->before_next));
    return *share > 0;
}
