/* The primitives of Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s, from a vetted library: openssl.c has them from libcrypto.
 *
 * libsodium and Monocypher have no BLAKE2s. For a microcontroller, write the same seven functions over a library that
 * has it, such as wolfCrypt. Do not write the primitives yourself. */
#ifndef HN_CRYPTO_H
#define HN_CRYPTO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hapticnet_constants.h"

enum { HN_KEY_BYTES = 32, HN_NONCE_BYTES = 12 };

/* X25519 (RFC 7748); false if the result is zero, which a point of low order gives. */
bool hn_public_of(uint8_t public_key[HN_KEY_BYTES], const uint8_t private_key[HN_KEY_BYTES]);
bool hn_shared_secret(uint8_t secret[HN_KEY_BYTES], const uint8_t private_key[HN_KEY_BYTES],
                      const uint8_t public_key[HN_KEY_BYTES]);

/* BLAKE2s (RFC 7693) of two pieces of data, HMAC with it, and its keyed mode with 16 bytes of output. */
bool hn_hash(uint8_t digest[HN_KEY_BYTES], const void *first, size_t first_size, const void *second,
             size_t second_size);
bool hn_hmac(uint8_t digest[HN_KEY_BYTES], const uint8_t key[HN_KEY_BYTES], const void *data, size_t size);
bool hn_mac(uint8_t mac[16], const uint8_t key[HN_KEY_BYTES], const void *data, size_t size);

/* ChaCha20-Poly1305 (RFC 8439); what is sealed is HN_TAG_BYTES longer. Input and output may not overlap. */
bool hn_seal(uint8_t *sealed, const uint8_t key[HN_KEY_BYTES], const uint8_t nonce[HN_NONCE_BYTES], const void *head,
             size_t head_size, const void *plain, size_t size);
bool hn_open(uint8_t *plain, const uint8_t key[HN_KEY_BYTES], const uint8_t nonce[HN_NONCE_BYTES], const void *head,
             size_t head_size, const void *sealed, size_t size);

#endif
