#include "announced.h"

#include <string.h>

#include "values.h"

/* Those of a second, and more while several models catch up by turns. */
enum { ROOM = HN_MOST_REMEMBERED + 256 };

size_t hn_announced_bytes(unsigned axes)
{
    return hn_trail_bytes(axes, ROOM);
}

void hn_announced_init(hn_announced *a, unsigned axes, hn_allowance *allowance, uint8_t **memory)
{
    memset(a, 0, sizeof *a);
    a->allowance = allowance;
    hn_trail_init(&a->trail, axes, ROOM, memory);
}

void hn_announced_begin(hn_announced *a, double stiffest_n_m)
{
    a->stiffest_n_m = stiffest_n_m;
    a->trail.end = 0;
    a->taken = a->settled = 0;
    a->on_model = a->is_late = a->waits = false;
}

/* Begin the model that waits at the remembered position of its time. */
static void begin(hn_announced *a)
{
    uint64_t start = hn_trail_start(&a->trail, HN_MOST_REMEMBERED);
    uint64_t after = hn_trail_after(&a->trail, start, a->waiting_us), first = after > start ? after - 1 : start;
    const double *before_m = first > start ? hn_trail_place(&a->trail, first - 1) : NULL;
    int64_t before_us = first > start ? hn_trail_time(&a->trail, first - 1) : 0;
    a->late = a->waiting;
    hn_model_begin(&a->late, hn_trail_time(&a->trail, first), hn_trail_place(&a->trail, first), before_us, before_m);
    a->late_number = a->taken;
    a->late_cost = 1 + (int)a->late.count;
    a->next = first + 1;
    a->allowance->left -= HN_COST_OF_BEGINNING * a->late_cost;
    a->is_late = true;
    a->waits = false;
}

/* Step received models through past positions within the allowance; apply one that has caught up. */
static void catch_up(hn_announced *a)
{
    while (a->allowance->left > 0 && (a->is_late || a->waits)) {
        if (!a->is_late)
            begin(a);
        uint64_t oldest = hn_trail_start(&a->trail, UINT64_MAX);
        a->next = a->next < oldest ? oldest : a->next;
        for (; a->next < a->trail.end && a->allowance->left > 0; a->next++) {
            hn_model_step(&a->late, hn_trail_time(&a->trail, a->next), hn_trail_place(&a->trail, a->next));
            a->allowance->left -= a->late_cost;
        }
        if (a->next < a->trail.end)
            return;
        a->model = a->late;
        a->settled = a->late_number;
        a->on_model = true;
        a->is_late = false;
    }
}

void hn_announced_move(hn_announced *a, int64_t t_us, const double position_m[])
{
    hn_trail *trail = &a->trail;
    if (trail->end > 0) {
        int64_t newest_us = hn_trail_time(trail, trail->end - 1);
        const double *newest_m = hn_trail_place(trail, trail->end - 1);
        bool same = t_us == newest_us;
        for (unsigned i = 0; i < trail->axes; i++)
            same = same && position_m[i] == newest_m[i];
        if (t_us < newest_us || same)
            return;
    }
    hn_trail_add(trail, t_us, position_m);
    if (!a->allowance->renewed || t_us != a->allowance->t_us)
        *a->allowance = (hn_allowance){HN_MOST_PLAYED, true, t_us};
    if (a->on_model)
        hn_model_step(&a->model, t_us, position_m);
    if (a->settled != a->taken)
        catch_up(a);
}

bool hn_announced_decode(hn_announced *a, int64_t t_us, hn_bytes payload)
{
    hn_model read;
    if (!hn_read_model(payload, a->trail.axes, a->stiffest_n_m, &read) || a->trail.end == 0)
        return false;
    a->taken++;
    a->waiting = read;
    a->waiting_us = t_us;
    a->waits = true;
    catch_up(a);
    return true;
}

void hn_announced_end_model(hn_announced *a)
{
    a->on_model = a->is_late = a->waits = false;
    a->settled = a->taken;
}
