/* The encoders of raw and deadband: docs/refer/payloads.md. */
#ifndef HN_ENCODER_H
#define HN_ENCODER_H

#include "codec.h"

void hn_encoder_init(hn_encoder *e, const hn_settings *settings);
void hn_encoder_refresh(hn_encoder *e); /* the next stimulus is sent */
/* Write the payload of a stimulus, at most 24 bytes, and return its size; 0 if nothing is to be sent. */
size_t hn_encode(hn_encoder *e, const double stimulus_n[], uint8_t *payload);

#endif
