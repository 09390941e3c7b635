/* The decoders of every codec: docs/refer/payloads.md and examples/literature/PAYLOADS.md. */
#ifndef HN_DECODER_H
#define HN_DECODER_H

#include "codec.h"

void hn_decoder_init(hn_decoder *d, const hn_settings *settings);
/* Take in a payload for a time; return false, and change nothing, if it must be refused. */
bool hn_decode(hn_decoder *d, int64_t t_us, hn_bytes payload);
/* Move the receiver's own tool, which some codecs follow. */
void hn_decoder_move(hn_decoder *d, int64_t t_us, const double position_m[]);
/* Give the stimulus to apply at a time. */
void hn_decoder_apply(const hn_decoder *d, int64_t t_us, double stimulus_n[]);
bool hn_follows_motion(int codec);
bool hn_needs_position(int codec); /* whether the encoder or the decoder follows the motion */

#endif
