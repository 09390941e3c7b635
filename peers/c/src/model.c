#include "model.h"

#include <math.h>
#include <string.h>

#include "values.h"

enum { PIERCED = 1, BREACHES = 2, VISCOUS = 4, STIFFENS = 8, RUBS = 16, RECOVERS = 32, ALL_FLAGS = 63 };

static double most(double a, double b)
{
    return a > b ? a : b;
}

double hn_stiffest(double rate_hz)
{
    return fmin(HN_STIFFEST_N_PER_M, HN_STIFFEST_PER_HZ * rate_hz);
}

/* Reading */

typedef struct {
    hn_bytes left;
    bool ok;
} reader;

/* Read a float32 that is within its range, or zero where that is allowed. */
static double get(reader *r, double least, double largest, bool or_zero)
{
    if (r->left.size < 4) {
        r->ok = false;
        return least;
    }
    double value = hn_read_single(r->left.at);
    r->left = (hn_bytes){r->left.at + 4, r->left.size - 4};
    r->ok = r->ok && ((least <= value && value <= largest) || (or_zero && value == 0.0)); /* NaN is refused */
    return value;
}

static void read_layer(reader *r, unsigned axes, hn_layer *layer)
{
    unsigned flags = r->left.size > 0 ? r->left.at[0] : ALL_FLAGS + 1;
    memset(layer, 0, sizeof *layer);
    if (flags > ALL_FLAGS) {
        r->ok = false;
        return;
    }
    r->left = (hn_bytes){r->left.at + 1, r->left.size - 1};
    layer->pierced = flags & PIERCED;
    layer->surface_m = get(r, -HN_LARGEST_VALUE, HN_LARGEST_VALUE, false);
    layer->stiffness_n_m = get(r, HN_SMALLEST_VALUE, HN_STIFFEST_N_PER_M, false);
    layer->breach_n = INFINITY;
    if (flags & BREACHES)
        layer->breach_n = get(r, HN_SMALLEST_VALUE, INFINITY, false);
    r->ok = r->ok && (layer->breach_n <= HN_LARGEST_VALUE || layer->breach_n == INFINITY);
    if (flags & VISCOUS)
        layer->viscosity_n_s_m = get(r, HN_SMALLEST_VALUE, HN_LARGEST_VISCOSITY, true);
    if (flags & STIFFENS)
        layer->stiffening_per_m = get(r, HN_SMALLEST_VALUE, HN_LARGEST_VALUE, true);
    if (flags & RUBS) {
        layer->friction_n = get(r, HN_SMALLEST_VALUE, HN_LARGEST_VALUE, true);
        layer->presliding_m = get(r, HN_SMALLEST_VALUE, HN_LARGEST_VALUE, false);
        layer->shaft_n = get(r, -HN_LARGEST_VALUE, HN_LARGEST_VALUE, false);
    }
    if (flags & RECOVERS) {
        layer->recovery_s = get(r, HN_SMALLEST_VALUE, HN_LARGEST_VALUE, true);
        layer->raised_m = get(r, 0.0, HN_LARGEST_VALUE, false);
    }
    layer->normal[0] = 1.0;
    for (unsigned i = 0; i < axes && axes > 1; i++)
        layer->normal[i] = get(r, -2.0, 2.0, false);
    double length = sqrt(hn_inner(layer->normal, layer->normal, axes));
    r->ok = r->ok && 0.99 <= length && length <= 1.01;
}

bool hn_read_model(hn_bytes payload, unsigned axes, double stiffest_n_m, hn_model *model)
{
    double total = 0.0;
    if (payload.size < 2 || payload.at[0] != 1 || payload.at[1] > HN_MOST_LAYERS)
        return false;
    reader r = {{payload.at + 2, payload.size - 2}, true};
    model->axes = axes;
    model->count = payload.at[1];
    for (unsigned i = 0; i < model->count && r.ok; i++) {
        hn_layer *layer = &model->layers[i];
        read_layer(&r, axes, layer);
        total += layer->stiffness_n_m + layer->stiffening_per_m * fmin(layer->breach_n, HN_LARGEST_FORCE_N);
    }
    return r.ok && r.left.size == 0 && total <= stiffest_n_m * (1.0 + HN_MODEL_ROUNDING);
}

/* Physics. Depths are along the normal, from the surface at rest. */

static double depth_of(const hn_layer *layer, const double position_m[], unsigned axes)
{
    return hn_inner(position_m, layer->normal, axes) - layer->surface_m;
}

/* Pierce a layer at a depth, or heal it: a healed surface keeps returning. */
static void become(hn_layer *layer, bool pierced, double depth_m)
{
    layer->pierced = pierced;
    layer->shaft_n = 0.0;
    layer->depth_m = depth_m;
    if (pierced && layer->recovery_s != 0.0)
        layer->raised_m = depth_m;
}

/* Return the friction of a pierced layer, after Dahl. */
static double slide(hn_layer *layer, double depth_m)
{
    double travel_m = depth_m - layer->depth_m;
    if (layer->friction_n != 0.0 && travel_m != 0.0) {
        double sliding_n = copysign(layer->friction_n, travel_m), held = exp(-fabs(travel_m) / layer->presliding_m);
        layer->shaft_n = sliding_n + (layer->shaft_n - sliding_n) * held;
    }
    layer->depth_m = depth_m;
    return layer->shaft_n;
}

static double elastic_force(const hn_layer *layer, double indentation_m)
{
    double exponent = layer->stiffening_per_m * indentation_m;
    if (exponent > HN_LARGEST_EXPONENT)
        return INFINITY;
    if (exponent != 0.0)
        return layer->stiffness_n_m / layer->stiffening_per_m * expm1(exponent);
    return layer->stiffness_n_m * indentation_m;
}

static double press_layer(hn_layer *layer, double depth_m, double speed_m_s)
{
    if (layer->pierced && depth_m >= layer->raised_m)
        return slide(layer, depth_m);
    if (layer->pierced)
        become(layer, false, depth_m);
    double indentation_m = depth_m - layer->raised_m;
    if (indentation_m <= 0.0)
        return 0.0;
    double force_n = elastic_force(layer, indentation_m);
    if (force_n > layer->breach_n) {
        become(layer, true, fmin(layer->raised_m + layer->breach_depth_m, depth_m));
        return slide(layer, depth_m);
    }
    if (layer->viscosity_n_s_m != 0.0) {
        double speed = fmin(fmax(speed_m_s, -HN_LARGEST_SPEED_M_PER_S), HN_LARGEST_SPEED_M_PER_S);
        force_n = most(force_n + layer->viscosity_n_s_m * speed, 0.0);
    }
    return fmin(force_n, HN_LARGEST_FORCE_N);
}

static void move(hn_model *model, int64_t t_us, const double position_m[])
{
    int64_t elapsed_us = t_us - model->t_us;
    for (unsigned i = 0; i < model->axes; i++) {
        double way = position_m[i] - model->position_m[i];
        model->velocity_m_s[i] = elapsed_us > 0 ? way * (1e6 / (double)elapsed_us) : 0.0;
    }
    model->t_us = t_us;
    hn_copy(model->position_m, position_m, model->axes);
}

static void press(hn_model *model)
{
    unsigned axes = model->axes;
    memset(model->force_n, 0, sizeof model->force_n);
    for (hn_layer *layer = model->layers; layer < model->layers + model->count; layer++) {
        double depth_m = depth_of(layer, model->position_m, axes);
        if (depth_m <= 0.0 && !layer->pierced)
            continue;
        double force_n = press_layer(layer, depth_m, hn_inner(model->velocity_m_s, layer->normal, axes));
        for (unsigned i = 0; i < axes && force_n != 0.0; i++)
            model->force_n[i] = model->force_n[i] + layer->normal[i] * force_n;
    }
}

void hn_model_begin(hn_model *model, int64_t t_us, const double position_m[], int64_t before_us,
                    const double *before_m)
{
    for (hn_layer *layer = model->layers; layer < model->layers + model->count; layer++) {
        double stretch_m = layer->breach_n / layer->stiffness_n_m, a = layer->stiffening_per_m;
        layer->raised_m = layer->recovery_s != 0.0 ? layer->raised_m : 0.0;
        layer->depth_m = depth_of(layer, position_m, model->axes);
        layer->breach_depth_m = a != 0.0 ? log1p(a * stretch_m) / a : stretch_m;
    }
    model->t_us = before_m != NULL ? before_us : t_us;
    hn_copy(model->position_m, before_m != NULL ? before_m : position_m, model->axes);
    move(model, t_us, position_m);
    press(model);
}

void hn_model_step(hn_model *model, int64_t t_us, const double position_m[])
{
    int64_t elapsed_us = t_us - model->t_us;
    for (hn_layer *layer = model->layers; layer < model->layers + model->count && elapsed_us > 0; layer++)
        if (layer->raised_m != 0.0)
            layer->raised_m *= exp(-1e-6 * (double)elapsed_us / layer->recovery_s);
    move(model, t_us, position_m);
    press(model);
}

void hn_model_predict(const hn_model *model, int64_t t_us, const double position_m[], double force_n[])
{
    hn_model ahead = *model;
    hn_model_begin(&ahead, model->t_us, model->position_m, 0, NULL);
    hn_model_step(&ahead, t_us, position_m);
    hn_copy(force_n, ahead.force_n, model->axes);
}

unsigned hn_model_state(const hn_model *model)
{
    unsigned state = 0;
    for (unsigned i = 0; i < model->count; i++)
        state |= (unsigned)model->layers[i].pierced << i;
    return state;
}
