#include "past.h"

#include <math.h>
#include <string.h>

#include "hold.h"
#include "values.h"

/* Positions */

size_t hn_trail_bytes(unsigned axes, unsigned room)
{
    return room * (sizeof(int64_t) + axes * sizeof(double));
}

void hn_trail_init(hn_trail *t, unsigned axes, unsigned room, uint8_t **memory)
{
    *t = (hn_trail){axes, room, 0, (int64_t *)(void *)*memory, NULL};
    t->position_m = (double *)(void *)(*memory + room * sizeof(int64_t));
    *memory += hn_trail_bytes(axes, room);
}

void hn_trail_add(hn_trail *t, int64_t t_us, const double position_m[])
{
    unsigned at = (unsigned)(t->end++ % t->room);
    t->t_us[at] = t_us;
    hn_copy(t->position_m + at * t->axes, position_m, t->axes);
}

int64_t hn_trail_time(const hn_trail *t, uint64_t index)
{
    return t->t_us[index % t->room];
}

const double *hn_trail_place(const hn_trail *t, uint64_t index)
{
    return t->position_m + index % t->room * t->axes;
}

uint64_t hn_trail_start(const hn_trail *t, uint64_t most)
{
    most = most < t->room ? most : t->room;
    return t->end > most ? t->end - most : 0;
}

uint64_t hn_trail_after(const hn_trail *t, uint64_t start, int64_t t_us)
{
    uint64_t end = t->end;
    while (start < end) {
        uint64_t middle = start + (end - start) / 2;
        if (hn_trail_time(t, middle) <= t_us)
            start = middle + 1;
        else
            end = middle;
    }
    return start;
}

/* The limit */

/* Positions of a second and the way before, at a rate that a program may exceed a little. */
static unsigned room_for(double rate_hz)
{
    return (unsigned)(1.02 * rate_hz * (1e-6 * HN_LATELY_US)) + HN_WAY + 16;
}

size_t hn_past_bytes(unsigned axes, double rate_hz)
{
    return hn_trail_bytes(axes, room_for(rate_hz)) + room_for(rate_hz) * (sizeof(int64_t) + sizeof(double));
}

void hn_past_init(hn_past *p, unsigned axes, double rate_hz, uint8_t **memory)
{
    p->room = room_for(rate_hz);
    hn_trail_init(&p->trail, axes, p->room, memory);
    p->peak_us = (int64_t *)(void *)*memory;
    p->peak_n = (double *)(void *)(*memory + p->room * sizeof(int64_t));
    *memory += p->room * (sizeof(int64_t) + sizeof(double));
}

void hn_past_begin(hn_past *p, const hn_settings *settings, int64_t free_us)
{
    hn_decoder_init(&p->behind, settings);
    p->trail.end = p->start = 0;
    p->answered = p->is_free = false;
    p->free_us = free_us;
    p->limit_n = HN_PAST_MARGIN_N;
    p->first = p->peaks = 0;
}

/* Return the first index of the positions of the last second. */
static uint64_t start_of(const hn_past *p)
{
    uint64_t remembered = hn_trail_start(&p->trail, UINT64_MAX);
    return p->start > remembered ? p->start : remembered;
}

void hn_past_decode(hn_past *p, int64_t t_us, hn_bytes payload)
{
    if (!p->answered) { /* the velocity there */
        uint64_t start = start_of(p), end = hn_trail_after(&p->trail, start, t_us);
        for (uint64_t i = end - start > HN_WAY ? end - HN_WAY : start; i < end; i++)
            hn_decoder_move(&p->behind, hn_trail_time(&p->trail, i), hn_trail_place(&p->trail, i));
        p->answered = true;
        p->answered_us = t_us;
    }
    hn_decode(&p->behind, t_us, payload);
}

/* Note a position of the tool, and forget those of more than a second before. */
static void move(hn_past *p, int64_t t_us, const double position_m[])
{
    bool is_first = p->trail.end == 0;
    if (!is_first && t_us <= hn_trail_time(&p->trail, p->trail.end - 1))
        return;
    hn_trail_add(&p->trail, t_us, position_m);
    if (is_first)
        p->start_us = t_us;
    if (p->start_us >= t_us - 2 * HN_LATELY_US)
        return;
    p->start = hn_trail_after(&p->trail, start_of(p), t_us - HN_LATELY_US);
    p->start_us = hn_trail_time(&p->trail, p->start);
}

/* Return a peak, 0 being the oldest. */
static unsigned place_of(const hn_past *p, unsigned index)
{
    return (p->first + index) % p->room;
}

static void forget_oldest(hn_past *p)
{
    p->first = place_of(p, 1);
    p->peaks--;
}

/* Note the force at an answered position. */
static void note(hn_past *p, double size_n, int64_t now_us)
{
    while (p->peaks > 0 && p->peak_n[place_of(p, p->peaks - 1)] <= size_n)
        p->peaks--;
    /* A smaller one of the same time never becomes the oldest that counts. */
    if (p->peaks == 0 || p->peak_us[place_of(p, p->peaks - 1)] != now_us) {
        if (p->peaks == p->room)
            forget_oldest(p);
        p->peak_us[place_of(p, p->peaks)] = now_us;
        p->peak_n[place_of(p, p->peaks++)] = size_n;
    }
    while (p->peak_us[p->first] < now_us - HN_LATELY_US && p->peaks > 1)
        forget_oldest(p);
    p->limit_n = HN_PAST_GROWTH * p->peak_n[p->first] + HN_PAST_MARGIN_N;
}

void hn_past_limit(hn_past *p, int64_t t_us, const double position_m[], int64_t position_us, double force_n[])
{
    unsigned axes = p->trail.axes;
    hn_vector answered_n;
    move(p, position_us, position_m);
    p->is_free = position_us - t_us <= p->free_us;
    if (p->answered && t_us >= p->answered_us) { /* jitter may move the time back */
        uint64_t start = start_of(p), after = hn_trail_after(&p->trail, start, t_us);
        p->answered_us = t_us;
        hn_decoder_move(&p->behind, t_us, hn_trail_place(&p->trail, after > start ? after - 1 : start));
        hn_decoder_apply(&p->behind, t_us, answered_n);
        note(p, hn_norm(answered_n, axes), position_us);
    }
    double size_n = hn_norm(force_n, axes);
    for (unsigned i = 0; i < axes && !p->is_free && size_n > p->limit_n; i++)
        force_n[i] = force_n[i] * (p->limit_n / size_n);
}
