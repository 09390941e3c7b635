/* Codecs by name, and their parameters. */
#ifndef HN_CODEC_H
#define HN_CODEC_H

#include "hapticnet.h"
#include "pack.h"

#define HN_CODEC_OF(symbol, name, parameters) symbol,
enum { HN_CODECS(HN_CODEC_OF) HN_CODEC_UNKNOWN };

int hn_codec_named(hn_bytes name);
void hn_set_defaults(hn_settings *s);                            /* of its codec */
const char *hn_set(hn_settings *s, hn_bytes name, double value); /* NULL, or what is wrong */
bool hn_get(const hn_settings *s, const char *name, double *value); /* whether there is such a parameter */
const char *hn_law_wrong(const hn_settings *s); /* NULL, or what is wrong with its law */

double hn_threshold(const hn_settings *s, double size_n);
double hn_limit(double component);
bool hn_in_range(const double x[], unsigned axes);

/* Big-endian numbers of payloads. */
double hn_read_half(const uint8_t *at);
double hn_read_single(const uint8_t *at);
double hn_read_double(const uint8_t *at);
int hn_read_count(const uint8_t *at);
void hn_store_single(uint8_t *at, double value);
void hn_store_double(uint8_t *at, double value);
void hn_store_count(uint8_t *at, int count);
void hn_store_half(uint8_t *at, double value);

#endif
