/* The decoders of examples/literature/PAYLOADS.md. */
#ifndef HN_LITERATURE_H
#define HN_LITERATURE_H

#include "codec.h"

/* Payloads, which are refused as in hn_decode; motion of the receiver; and what is applied. */
bool hn_decode_passive(hn_decoder *d, int64_t t_us, hn_bytes payload);
void hn_turn(hn_decoder *d, const double position_m[]);
void hn_apply_passive(const hn_decoder *d, int64_t t_us, double stimulus_n[]);
bool hn_decode_wall(hn_decoder *d, hn_bytes payload);
void hn_blend(hn_decoder *d, int64_t t_us);
void hn_apply_wall(const hn_decoder *d, double stimulus_n[]);
bool hn_decode_squares(hn_decoder *d, int64_t t_us, hn_bytes payload);
bool hn_decode_levels(hn_decoder *d, hn_bytes payload);

#endif
