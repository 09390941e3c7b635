/* Keys as hapticnet writes them: 32 bytes as 44 characters of base64, and files that `hapticnet key new` makes.
 *
 * This is the only part of the library that reads files. Leave it out on a microcontroller, which has no files. */
#ifndef HAPTICNET_KEYS_H
#define HAPTICNET_KEYS_H

#include "hapticnet_sealed.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { HN_KEY_TEXT_BYTES = 45, HN_WRONG_BYTES = 600 };

/* Read and write a key as base64. A key has one spelling; any other is refused, with false. */
bool hn_parse_key(hn_key key, const char *text);
void hn_format_key(char text[HN_KEY_TEXT_BYTES], const hn_key key);

/* Give the public key of a private one; false if libcrypto lacks X25519, as in FIPS mode. */
bool hn_derive_public(hn_key public_key, const hn_key private_key);

/* Read a host's key file; NULL: $XDG_CONFIG_HOME/hapticnet/key.toml, or that in ~/.config. Without a pre-shared key,
 * `psk` is zero. Return NULL, or `wrong`, which then says what is wrong with the file. As in hapticnet, only its owner may
 * read it, and only its owner and root may change it; where there is no stat(), this is not checked. */
const char *hn_load_key(const char *path, hn_key private_key, hn_key psk, char wrong[HN_WRONG_BYTES]);

/* Read the masters that a slave serves, at most `most`; NULL: masters.toml beside the default key file. A list that
 * gives a master its own scene or limits is refused: a slave of this library has the same for all. */
const char *hn_load_masters(const char *path, hn_listed listed[], size_t most, size_t *count,
                            char wrong[HN_WRONG_BYTES]);

#ifdef __cplusplus
}
#endif

#endif
