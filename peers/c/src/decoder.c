#include "decoder.h"

#include <math.h>
#include <string.h>

#include "hold.h"
#include "literature.h"
#include "values.h"

/* Curves: a value, and where it goes. */

static double share_of_curve(const hn_decoder *d, int64_t t_us)
{
    double s = (double)(t_us - d->t_us) / (d->horizon_ms * 1000.0);
    return s <= 0.0 ? 0.0 : s >= 1.0 ? 1.0 : s * (2.0 - s);
}

/* Read the travel of a curve from its multiples of the threshold. */
static bool read_travel(const hn_decoder *d, const uint8_t *at, const double value[], double travel[])
{
    double threshold_n = hn_threshold(&d->settings, hn_norm(value, d->settings.axes));
    hn_vector end;
    bool good = true;
    hn_read_halves(at, travel, d->settings.axes);
    EACH_AXIS(i)
    {
        good = good && fabs(travel[i]) <= 1024.0;
        travel[i] *= threshold_n;
        end[i] = value[i] + travel[i];
    }
    return good && hn_in_range(end, d->settings.axes);
}

static void on_curve(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    double share = share_of_curve(d, t_us);
    EACH_AXIS(i) stimulus_n[i] = d->value[i] + d->slope[i] * share;
}

/* motion-predictive */

static bool decode_motion(hn_decoder *d, hn_bytes payload)
{
    enum { HOLD, CURVE, SURFACE, COUPLED };
    unsigned axes = d->settings.axes, kind = payload.size > 0 ? payload.at[0] & ~8u : 255;
    if (kind > COUPLED)
        return false;
    bool wide = payload.at[0] & 8;
    size_t values = axes * (wide ? 8u : 4u);
    const size_t rest[] = {0, 2 * axes, 2 * axes + (axes > 1 ? 2 : 0), 4 * axes + 4};
    if (payload.size != 1 + values + rest[kind])
        return false;

    const uint8_t *at = payload.at + 1 + values;
    double stiffest = 1.002 * d->settings.set[HN_MOTION_PREDICTIVE_STIFFEST_N_PER_M], stiffness = 0.0, viscosity = 0.0;
    hn_vector value, travel = {0}, normal = {0};
    if (!(wide ? hn_read_doubles(payload.at + 1, value, axes) : hn_read_singles(payload.at + 1, value, axes)))
        return false;
    if (kind == CURVE && !read_travel(d, at, value, travel))
        return false;
    if (kind == SURFACE) {
        hn_read_halves(at, normal, axes);
        stiffness = axes > 1 ? hn_read_half(at + 2 * axes) : 0.0;
        double along = hn_inner(normal, normal, axes);
        if (!(0.0 < along && along <= stiffest && 0.0 <= stiffness && stiffness <= stiffest))
            return false;
    }
    if (kind == COUPLED) {
        stiffness = hn_read_half(at + 4 * axes);
        viscosity = hn_read_half(at + 4 * axes + 2);
        if (!hn_read_singles(at, travel, axes) ||
            !(0.0 <= stiffness && stiffness <= stiffest && 0.0 <= viscosity && viscosity <= 1000.0))
            return false;
    }
    hn_copy(d->value, value, axes);
    hn_copy(d->slope, travel, axes);
    hn_copy(d->of.motion.normal, normal, axes);
    d->of.motion.kind = (int)kind;
    d->of.motion.stiffness = stiffness;
    d->of.motion.viscosity = viscosity;
    return true;
}

static void on_surface(const hn_decoder *d, double stimulus_n[])
{
    unsigned axes = d->settings.axes;
    const double *normal = d->of.motion.normal, *at = d->at.position_m, k = d->of.motion.stiffness;
    double depth = hn_inner(normal, at, axes), along = hn_inner(normal, normal, axes);
    EACH_AXIS(i)
    {
        double added = depth * normal[i];
        if (k != 0.0)
            added = added + k * (at[i] + (-depth / along) * normal[i]);
        stimulus_n[i] = d->value[i] + added;
    }
    double out = hn_inner(normal, stimulus_n, axes);
    EACH_AXIS(i)
    {
        if (out < 0.0)
            stimulus_n[i] = stimulus_n[i] + (-out / along) * normal[i];
        stimulus_n[i] = hn_limit(stimulus_n[i]);
    }
}

static void apply_motion(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    double share = share_of_curve(d, t_us);
    if (d->of.motion.kind < 2) {
        on_curve(d, t_us, stimulus_n);
    } else if (!d->at.has_position) {
        EACH_AXIS(i) stimulus_n[i] = 0.0;
    } else if (d->of.motion.kind == 2) {
        on_surface(d, stimulus_n);
    } else {
        EACH_AXIS(i)
        {
            double along = (d->value[i] + share * d->slope[i]) + d->of.motion.stiffness * d->at.position_m[i];
            stimulus_n[i] = hn_limit(along + d->of.motion.viscosity * d->at.velocity_m_s[i]);
        }
    }
}

static void measure_velocity(hn_decoder *d, int64_t t_us, const double position_m[])
{
    const double tau = 0.005;
    bool follows = d->at.has_position && t_us > d->at.t_us;
    double passed = tau + (double)(t_us - d->at.t_us) * 1e-6;
    EACH_AXIS(i)
    {
        double way = position_m[i] - d->at.position_m[i];
        d->at.velocity_m_s[i] = follows ? (way + tau * d->at.velocity_m_s[i]) / passed : 0.0;
    }
}

/* All codecs */

static bool decode_curve(hn_decoder *d, hn_bytes payload)
{
    unsigned axes = d->settings.axes;
    hn_vector value, travel;
    if (payload.size < 2 * axes || !hn_read_value(d, payload.at, payload.size - 2 * axes, value) ||
        !read_travel(d, payload.at + payload.size - 2 * axes, value, travel))
        return false;
    hn_copy(d->value, value, axes);
    hn_copy(d->slope, travel, axes);
    return true;
}

static bool decode_line(hn_decoder *d, hn_bytes payload)
{
    hn_vector value, slope;
    if (!hn_read_line(d, payload.at, payload.size, value, slope))
        return false;
    hn_copy(d->value, value, d->settings.axes);
    hn_copy(d->slope, slope, d->settings.axes);
    return true;
}

static bool decode_value(hn_decoder *d, hn_bytes payload)
{
    hn_vector value;
    if (!hn_read_value(d, payload.at, payload.size, value))
        return false;
    hn_copy(d->value, value, d->settings.axes);
    return true;
}

static bool decode(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    switch (d->settings.codec) {
    case HN_CODEC_ADAPTIVE_PREDICTIVE:
        return decode_curve(d, payload);
    case HN_CODEC_MOTION_PREDICTIVE:
        return decode_motion(d, payload);
    case HN_CODEC_LINEAR_PREDICTIVE:
        return decode_line(d, payload);
    case HN_CODEC_LEAST_SQUARES:
        return hn_decode_squares(d, t_us, payload);
    case HN_CODEC_LEVEL_CROSSING:
        return hn_decode_levels(d, payload);
    case HN_CODEC_PASSIVE_EXTRAPOLATIVE:
    case HN_CODEC_PASSIVE_INTERPOLATIVE:
        return hn_decode_passive(d, t_us, payload);
    case HN_CODEC_MODEL_MEDIATED:
        return hn_decode_wall(d, payload);
    default:
        return decode_value(d, payload);
    }
}

bool hn_decode(hn_decoder *d, int64_t t_us, hn_bytes payload)
{
    if (!decode(d, t_us, payload))
        return false;
    d->has_update = true;
    d->t_us = t_us;
    return true;
}

void hn_decoder_init(hn_decoder *d, const hn_settings *settings)
{
    memset(d, 0, sizeof *d);
    d->settings = *settings;
    hn_get(settings, "step_n", &d->step_n);
    hn_get(settings, "horizon_ms", &d->horizon_ms);
    if (settings->codec == HN_CODEC_LEAST_SQUARES)
        d->of.squares.number = 128;
}

bool hn_follows_motion(int codec)
{
    return codec == HN_CODEC_MOTION_PREDICTIVE || codec == HN_CODEC_PASSIVE_EXTRAPOLATIVE ||
           codec == HN_CODEC_PASSIVE_INTERPOLATIVE || codec == HN_CODEC_MODEL_MEDIATED;
}

bool hn_needs_position(int codec)
{
    return hn_follows_motion(codec) || codec == HN_CODEC_VELOCITY_ADAPTIVE;
}

void hn_decoder_move(hn_decoder *d, int64_t t_us, const double position_m[])
{
    if (d->settings.codec == HN_CODEC_MOTION_PREDICTIVE) {
        if (d->at.has_position && t_us == d->at.t_us)
            return;
        measure_velocity(d, t_us, position_m);
    } else if (d->settings.codec == HN_CODEC_MODEL_MEDIATED) {
        hn_blend(d, t_us);
    } else if (hn_follows_motion(d->settings.codec)) {
        hn_turn(d, position_m);
    } else {
        return;
    }
    d->at.has_position = true;
    d->at.t_us = t_us;
    hn_copy(d->at.position_m, position_m, d->settings.axes);
}

void hn_decoder_apply(const hn_decoder *d, int64_t t_us, double stimulus_n[])
{
    if (!d->has_update) {
        EACH_AXIS(i) stimulus_n[i] = 0.0;
        return;
    }
    switch (d->settings.codec) {
    case HN_CODEC_ADAPTIVE_PREDICTIVE:
        on_curve(d, t_us, stimulus_n);
        break;
    case HN_CODEC_MOTION_PREDICTIVE:
        apply_motion(d, t_us, stimulus_n);
        break;
    case HN_CODEC_LINEAR_PREDICTIVE:
    case HN_CODEC_LEAST_SQUARES:
        hn_on_line(d, t_us, stimulus_n);
        break;
    case HN_CODEC_PASSIVE_EXTRAPOLATIVE:
    case HN_CODEC_PASSIVE_INTERPOLATIVE:
        hn_apply_passive(d, t_us, stimulus_n);
        break;
    case HN_CODEC_MODEL_MEDIATED:
        hn_apply_wall(d, stimulus_n);
        break;
    default:
        hn_copy(stimulus_n, d->value, d->settings.axes);
    }
}
