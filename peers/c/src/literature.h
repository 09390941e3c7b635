/* The decoders of examples/literature/PAYLOADS.md, and what they share with the others. */
#ifndef HN_LITERATURE_H
#define HN_LITERATURE_H

#include "codec.h"

#define EACH_AXIS(i) for (unsigned i = 0; i < d->settings.axes; i++)

/* In decoder.c */
void hn_copy(double to[], const double from[], unsigned axes);
double hn_inner(const double x[], const double y[], unsigned axes);
bool hn_read_singles(const uint8_t *at, double x[], unsigned axes); /* whether they are in range */
bool hn_read_value(const hn_decoder *d, const uint8_t *at, size_t size, double value[]);
bool hn_read_line(const hn_decoder *d, const uint8_t *at, size_t size, double value[], double slope[]);
void hn_on_line(const hn_decoder *d, int64_t t_us, double stimulus_n[]);

/* In literature.c: payloads, which are refused as in hn_decode; motion of the receiver; and what is applied. */
bool hn_decode_passive(hn_decoder *d, int64_t t_us, hn_bytes payload);
void hn_turn(hn_decoder *d, const double position_m[]);
void hn_apply_passive(const hn_decoder *d, int64_t t_us, double stimulus_n[]);
bool hn_decode_wall(hn_decoder *d, hn_bytes payload);
void hn_blend(hn_decoder *d, int64_t t_us);
void hn_apply_wall(const hn_decoder *d, double stimulus_n[]);
bool hn_decode_squares(hn_decoder *d, int64_t t_us, hn_bytes payload);
bool hn_decode_levels(hn_decoder *d, hn_bytes payload);

#endif
