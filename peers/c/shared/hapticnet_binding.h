/* What a binding needs that cannot read hapticnet.h: nodes that the library keeps, and no structure to copy.
 *
 * The shared library exports this beside the functions of hapticnet.h, which take the nodes that are made here. */
#ifndef HAPTICNET_BINDING_H
#define HAPTICNET_BINDING_H

#include "hapticnet.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Make a master. `names` and `values` are numbers of the request (those of hn_request) and parameters of its codec;
 * the others have their defaults. All texts are copied. NULL: `wrong` says what is wrong, with the value. */
enum { HN_ERROR_BYTES = 600 };
hn_master *hn_make_master(const char *codec, const char *name, const char *const names[], const double values[],
                          size_t count, hn_entropy *entropy, void *context, char wrong[HN_ERROR_BYTES]);
hn_slave *hn_make_slave(const char *scene, unsigned axes, hn_entropy *entropy, void *context,
                        char wrong[HN_ERROR_BYTES]);
void hn_free_master(hn_master *m); /* these overwrite keys */
void hn_free_slave(hn_slave *s);

/* Seal one that was made here; `psk` may be NULL. A slave's masters are `count` times 64 bytes: a public key, and the
 * key that both share or zeros. Return NULL, or what is wrong. */
const char *hn_seal_master(hn_master *m, const uint8_t own_private[32], const uint8_t slave_public[32],
                           const uint8_t *psk);
const char *hn_seal_slave(hn_slave *s, const uint8_t own_private[32], const uint8_t *masters, size_t count);

/* Read a key file, or the list of masters, as hapticnet_keys.h has it. NULL, or `wrong`. */
const char *hn_read_key(const char *path, uint8_t private_key[32], uint8_t psk[32], char wrong[HN_ERROR_BYTES]);
const char *hn_read_masters(const char *path, uint8_t *masters, size_t most, size_t *count, char wrong[HN_ERROR_BYTES]);

/* Counts, by the names of hn_counts; 0 for other names. */
uint32_t hn_master_count(const hn_master *m, const char *name);
uint32_t hn_slave_count(const hn_slave *s, const char *name);

const char *hn_codec_name(unsigned index); /* NULL after the last */
size_t hn_datagram_bytes(void);
size_t hn_error_bytes(void);
unsigned hn_most_axes(void);

#ifdef __cplusplus
}
#endif

#endif
