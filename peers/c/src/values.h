/* Values and lines of payloads, which the decoders share. */
#ifndef HN_VALUES_H
#define HN_VALUES_H

#include "codec.h"

#define EACH_AXIS(i) for (unsigned i = 0; i < d->settings.axes; i++)

void hn_copy(double to[], const double from[], unsigned axes);
double hn_inner(const double x[], const double y[], unsigned axes);

/* Read a number for each axis; return whether they are in range. */
void hn_read_halves(const uint8_t *at, double x[], unsigned axes); /* their range is the caller's */
bool hn_read_singles(const uint8_t *at, double x[], unsigned axes);
bool hn_read_doubles(const uint8_t *at, double x[], unsigned axes);
bool hn_read_value(const hn_decoder *d, const uint8_t *at, size_t size, double value[]); /* counts, single or double */
bool hn_read_line(const hn_decoder *d, const uint8_t *at, size_t size, double value[], double slope[]);
void hn_on_line(const hn_decoder *d, int64_t t_us, double stimulus_n[]);

#endif
