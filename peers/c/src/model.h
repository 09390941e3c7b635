/* Models of the contact ahead: docs/refer/payloads.md, "Announced contact". */
#ifndef HN_MODEL_H
#define HN_MODEL_H

#include "codec.h"

typedef struct {
    double surface_m, stiffness_n_m, breach_n, viscosity_n_s_m, stiffening_per_m, friction_n, presliding_m, recovery_s;
    hn_vector normal;
    bool pierced;
    double raised_m, shaft_n;       /* how far a surface is behind its place at rest; the friction now */
    double depth_m, breach_depth_m; /* of the tool in a pierced layer; at which the layer breaks */
} hn_layer;

typedef struct {
    unsigned axes, count;
    hn_layer layers[HN_MOST_LAYERS];
    int64_t t_us;
    hn_vector position_m, velocity_m_s, force_n; /* at the newest position */
} hn_model;

/* Return the largest sum of stiffnesses that a master renders at a rate. */
double hn_stiffest(double rate_hz);
/* Read the layers of a model; return whether it is allowed. */
bool hn_read_model(hn_bytes payload, unsigned axes, double stiffest_n_m, hn_model *model);
/* Begin at a position, with the one before for the speed, or NULL. */
void hn_model_begin(hn_model *model, int64_t t_us, const double position_m[], int64_t before_us,
                    const double *before_m);
void hn_model_step(hn_model *model, int64_t t_us, const double position_m[]);
/* Give the force at a future position. */
void hn_model_predict(const hn_model *model, int64_t t_us, const double position_m[], double force_n[]);
/* Return the sum of 2^i over the layers that are pierced. */
unsigned hn_model_state(const hn_model *model);

#endif
