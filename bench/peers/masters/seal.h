/* Sealed sessions: Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s as initiator, and the seal of datagrams (OpenSSL's libcrypto). */
#ifndef MASTERS_SEAL_H
#define MASTERS_SEAL_H
#include <openssl/evp.h>
#include <stddef.h>
#include <stdint.h>

enum { KEY_BYTES = 32, TAG_BYTES = 16, NOISE1_MORE = 2 * KEY_BYTES + 2 * TAG_BYTES, NOISE2_MORE = KEY_BYTES + TAG_BYTES };

/* The handshake between its two messages. */
struct noise {
    uint8_t chain[KEY_BYTES], hash[KEY_BYTES], key[KEY_BYTES];
    EVP_PKEY *ephemeral;
};

struct seal {
    EVP_CIPHER_CTX *send, *receive;
};

int seal_load_keys(const char *file); /* three lines of hex: own private key, the slave's public key, psk */

/* Write the first message, NOISE1_MORE longer than the request, and the code that goes with it. */
void noise_write(struct noise *to, uint32_t nonce, const uint8_t *request, size_t bytes, uint8_t *message, uint8_t *mac);

/* Read the second message into `payload`, and make the keys; -1 if it does not open. */
int noise_read(struct noise *from, const uint8_t *message, size_t bytes, uint8_t *payload, struct seal *seal);

/* Seal `bytes` at `body` in place, with room for the tag after them; open them, the tag included, in place. */
void seal_close(struct seal *seal, uint32_t sequence, const uint8_t *head, size_t head_bytes, uint8_t *body, size_t bytes);
int seal_open(struct seal *seal, uint32_t sequence, const uint8_t *head, size_t head_bytes, uint8_t *body, size_t bytes);
#endif
