/* C twins of two codecs: the limit of a whole-array encoder, the same work as hapticnet's in a plain loop over one axis, with
 * float32 payloads and increasing times. Each takes a recording, Weber's law and the settings of its codec; it writes
 * what is applied at every sample and the index of every transmitted one, and returns how many were transmitted. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

static inline double larger(double x, double y)
{
    return x > y ? x : y;
}

static inline double smaller(double x, double y)
{
    return x < y ? x : y;
}

static inline double jnd_n(double reference_n, double weber_fraction, double floor_n)
{
    return larger(weber_fraction * fabs(reference_n), floor_n);
}
