#include "codec.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "hold.h"

#if FLT_EVAL_METHOD != 0
#error "Payloads decode in float64: compile so that double is computed as double (with SSE2 on x86)."
#endif

static const struct {
    int codec;
    const char *name, *wrong;
    double least, most;
    bool or_zero, whole;
    double by_default;
} PARAMETERS[] = {
#define ROW(codec, name, least, most, or_zero, whole, by_default, right) \
    {codec, name, name " must be " right, least, most, or_zero, whole, by_default},
    HN_PARAMETERS(ROW)
#undef ROW
};

enum { ROWS = sizeof PARAMETERS / sizeof *PARAMETERS };

static bool is(hn_bytes text, const char *name)
{
    return text.size == strlen(name) && memcmp(text.at, name, text.size) == 0;
}

int hn_codec_named(hn_bytes name)
{
#define CASE(symbol, text, parameters) \
    if (is(name, text)) \
        return symbol;
    HN_CODECS(CASE)
#undef CASE
    return HN_CODEC_UNKNOWN;
}

/* Return the row of a codec's first parameter; the others follow. */
static unsigned first_row(int codec)
{
    unsigned row = 0;
    while (row < ROWS && PARAMETERS[row].codec != codec)
        row++;
    return row;
}

void hn_set_defaults(hn_settings *s)
{
    unsigned first = first_row(s->codec);
    for (unsigned row = first; row < ROWS && PARAMETERS[row].codec == s->codec; row++)
        s->set[row - first] = PARAMETERS[row].by_default;
}

static bool is_allowed(unsigned row, double value)
{
    if (value == 0.0 && PARAMETERS[row].or_zero)
        return true;
    return PARAMETERS[row].least <= value && value <= PARAMETERS[row].most &&
           (!PARAMETERS[row].whole || value == floor(value));
}

/* What a parameter of a codec must be that has none of this name. */
static const char *no_such_parameter(int codec)
{
#define WRONG(symbol, name, parameters) "parameter must be one of " name "'s: " parameters,
    static const char *const wrong[] = {HN_CODECS(WRONG)};
#undef WRONG
    return codec < HN_CODEC_UNKNOWN ? wrong[codec] : HN_WRONG_CODEC;
}

const char *hn_set(hn_settings *s, hn_bytes name, double value)
{
    unsigned first = first_row(s->codec);
    for (unsigned row = first; row < ROWS && PARAMETERS[row].codec == s->codec; row++)
        if (is(name, PARAMETERS[row].name)) {
            s->set[row - first] = value;
            return is_allowed(row, value) ? NULL : PARAMETERS[row].wrong;
        }
    return no_such_parameter(s->codec);
}

bool hn_get(const hn_settings *s, const char *name, double *value)
{
    unsigned first = first_row(s->codec);
    for (unsigned row = first; row < ROWS && PARAMETERS[row].codec == s->codec; row++)
        if (strcmp(PARAMETERS[row].name, name) == 0) {
            *value = s->set[row - first];
            return true;
        }
    return false;
}

static bool is_zero_or(double value, double least, double most)
{
    return value == 0.0 || (least <= value && value <= most);
}

const char *hn_law_wrong(const hn_settings *s)
{
    if (!is_zero_or(s->weber_fraction, HN_LEAST_LAW, HN_MOST_WEBER_FRACTION))
        return HN_WRONG_WEBER_FRACTION;
    if (!is_zero_or(s->floor_n, HN_LEAST_LAW, HN_MOST_FLOOR_N))
        return HN_WRONG_FLOOR_N;
    return is_zero_or(s->multiplier, HN_LEAST_LAW, HN_MOST_MULTIPLIER) ? NULL : HN_WRONG_MULTIPLIER;
}

double hn_threshold(const hn_settings *s, double size_n)
{
    return fmax((s->multiplier * s->weber_fraction) * size_n, s->multiplier * s->floor_n);
}

double hn_limit(double component)
{
    return fmax(-HN_LARGEST_COMPONENT, fmin(component, HN_LARGEST_COMPONENT));
}

bool hn_in_range(const double x[], unsigned axes)
{
    for (unsigned i = 0; i < axes; i++)
        if (!(fabs(x[i]) <= HN_LARGEST_COMPONENT)) /* so that NaN is out of range */
            return false;
    return true;
}

static uint64_t read_bits(const uint8_t *at, unsigned size)
{
    uint64_t bits = 0;
    for (unsigned i = 0; i < size; i++)
        bits = bits << 8 | at[i];
    return bits;
}

double hn_read_half(const uint8_t *at)
{
    unsigned bits = (unsigned)read_bits(at, 2), exponent = bits >> 10 & 0x1f, fraction = bits & 0x3ff;
    double size = exponent == 0    ? ldexp(fraction, -24)
                  : exponent == 31 ? (fraction ? NAN : INFINITY)
                                   : ldexp(fraction + 0x400, (int)exponent - 25);
    return bits & 0x8000 ? -size : size;
}

double hn_read_single(const uint8_t *at)
{
    uint32_t bits = (uint32_t)read_bits(at, 4);
    float value;
    memcpy(&value, &bits, sizeof value);
    return (double)value;
}

double hn_read_double(const uint8_t *at)
{
    uint64_t bits = read_bits(at, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

int hn_read_count(const uint8_t *at)
{
    int bits = (int)read_bits(at, 2);
    return bits < 0x8000 ? bits : bits - 0x10000;
}

static void store(uint8_t *at, uint64_t bits, unsigned size)
{
    for (unsigned i = 0; i < size; i++)
        at[i] = (uint8_t)(bits >> 8 * (size - 1 - i));
}

void hn_store_single(uint8_t *at, double value)
{
    float single = (float)value;
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    store(at, bits, 4);
}

void hn_store_double(uint8_t *at, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    store(at, bits, 8);
}

void hn_store_count(uint8_t *at, int count)
{
    store(at, (uint64_t)count, 2);
}

/* The nearest float16 of a number within its range, halves to even. */
void hn_store_half(uint8_t *at, double value)
{
    int exponent;
    double size = fabs(value);
    frexp(size, &exponent);
    exponent = size == 0.0 || exponent < -13 ? -13 : exponent; /* below, float16 has one spacing */
    double steps = rint(ldexp(size, 11 - exponent));
    /* 2048 steps are 1024 of the next exponent, which carries as the bits do. */
    unsigned bits = (unsigned)steps + (unsigned)(exponent + 13) * 0x400u;
    store(at, bits | (signbit(value) ? 0x8000u : 0u), 2);
}
