/* See seal.h. Section numbers are those of the Noise Protocol Framework, revision 34. */
#include "seal.h"
#include "wire.h"
#include <openssl/core_names.h>
#include <openssl/hmac.h>
#include <openssl/params.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char NAME[] = "Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s", LABEL[] = "hapticnet mac1", PROLOGUE[] = "hapticnet 2";
static const uint8_t ZERO[12]; /* every key of the handshake seals once, with this nonce */
static uint8_t own_public[KEY_BYTES], peer_public[KEY_BYTES], psk[KEY_BYTES], mac_key[KEY_BYTES];
static EVP_PKEY *own, *peer;

static void must(int fine)
{
    if (fine <= 0) {
        fprintf(stderr, "masters: libcrypto failed\n");
        exit(1);
    }
}

static void hash2(uint8_t *to, const void *one, size_t one_bytes, const void *two, size_t two_bytes)
{
    EVP_MD_CTX *const context = EVP_MD_CTX_new();
    must(EVP_DigestInit_ex(context, EVP_blake2s256(), NULL));
    must(EVP_DigestUpdate(context, one, one_bytes));
    must(EVP_DigestUpdate(context, two, two_bytes));
    must(EVP_DigestFinal_ex(context, to, NULL));
    EVP_MD_CTX_free(context);
}

static int read_hex(FILE *file, uint8_t *to)
{
    for (int i = 0; i < KEY_BYTES; i++) {
        unsigned byte;
        if (fscanf(file, "%2x", &byte) != 1)
            return -1;
        to[i] = (uint8_t)byte;
    }
    return 0;
}

int seal_load_keys(const char *name)
{
    uint8_t private[KEY_BYTES];
    size_t bytes = KEY_BYTES;
    FILE *const file = fopen(name, "r");
    const int bad = !file || read_hex(file, private) || read_hex(file, peer_public) || read_hex(file, psk);
    if (file)
        fclose(file);
    if (bad)
        return -1;
    own = EVP_PKEY_new_raw_private_key(EVP_PKEY_X25519, NULL, private, KEY_BYTES);
    peer = EVP_PKEY_new_raw_public_key(EVP_PKEY_X25519, NULL, peer_public, KEY_BYTES);
    must(own && peer && EVP_PKEY_get_raw_public_key(own, own_public, &bytes));
    hash2(mac_key, LABEL, sizeof LABEL - 1, peer_public, KEY_BYTES);
    return 0;
}

static int shared_secret(EVP_PKEY *ours, EVP_PKEY *theirs, uint8_t *secret)
{
    size_t bytes = KEY_BYTES;
    EVP_PKEY_CTX *const context = EVP_PKEY_CTX_new(ours, NULL);
    const int fine = EVP_PKEY_derive_init(context) > 0 && EVP_PKEY_derive_set_peer(context, theirs) > 0
                     && EVP_PKEY_derive(context, secret, &bytes) > 0;
    EVP_PKEY_CTX_free(context);
    return fine ? 0 : -1;
}

/* HKDF with HMAC-BLAKE2s (section 4.3): two or three outputs. */
static void derive(const uint8_t *chain, const uint8_t *material, size_t bytes, uint8_t outputs[3][KEY_BYTES], int count)
{
    uint8_t secret[KEY_BYTES], block[KEY_BYTES + 1];
    HMAC(EVP_blake2s256(), chain, KEY_BYTES, material, bytes, secret, NULL);
    for (int i = 0; i < count; i++) {
        const size_t before = i ? KEY_BYTES : 0;
        if (i)
            memcpy(block, outputs[i - 1], KEY_BYTES);
        block[before] = (uint8_t)(i + 1);
        HMAC(EVP_blake2s256(), secret, KEY_BYTES, block, before + 1, outputs[i], NULL);
    }
}

static void mix_key(struct noise *noise, const uint8_t *material)
{
    uint8_t outputs[3][KEY_BYTES];
    derive(noise->chain, material, KEY_BYTES, outputs, 2);
    memcpy(noise->chain, outputs[0], KEY_BYTES);
    memcpy(noise->key, outputs[1], KEY_BYTES);
}

static void mix_hash(struct noise *noise, const uint8_t *data, size_t bytes)
{
    uint8_t mixed[KEY_BYTES];
    hash2(mixed, noise->hash, KEY_BYTES, data, bytes);
    memcpy(noise->hash, mixed, KEY_BYTES);
}

static EVP_CIPHER_CTX *cipher(const uint8_t *key, int encrypts)
{
    EVP_CIPHER_CTX *const context = EVP_CIPHER_CTX_new();
    must(EVP_CipherInit_ex(context, EVP_chacha20_poly1305(), NULL, key, NULL, encrypts));
    return context;
}

static void seal_with(EVP_CIPHER_CTX *context, const uint8_t *nonce, const uint8_t *head, size_t head_bytes,
                      uint8_t *body, size_t bytes)
{
    int done;
    must(EVP_EncryptInit_ex(context, NULL, NULL, NULL, nonce));
    must(EVP_EncryptUpdate(context, NULL, &done, head, (int)head_bytes));
    must(EVP_EncryptUpdate(context, body, &done, body, (int)bytes));
    must(EVP_EncryptFinal_ex(context, body + done, &done));
    must(EVP_CIPHER_CTX_ctrl(context, EVP_CTRL_AEAD_GET_TAG, TAG_BYTES, body + bytes));
}

static int open_with(EVP_CIPHER_CTX *context, const uint8_t *nonce, const uint8_t *head, size_t head_bytes,
                     uint8_t *body, size_t bytes)
{
    int done;
    if (bytes < TAG_BYTES)
        return -1;
    bytes -= TAG_BYTES;
    const int fine = EVP_DecryptInit_ex(context, NULL, NULL, NULL, nonce) > 0
                     && EVP_CIPHER_CTX_ctrl(context, EVP_CTRL_AEAD_SET_TAG, TAG_BYTES, body + bytes) > 0
                     && EVP_DecryptUpdate(context, NULL, &done, head, (int)head_bytes) > 0
                     && EVP_DecryptUpdate(context, body, &done, body, (int)bytes) > 0
                     && EVP_DecryptFinal_ex(context, body + done, &done) > 0;
    return fine ? 0 : -1;
}

static void encrypt(struct noise *noise, uint8_t *body, size_t bytes)
{
    EVP_CIPHER_CTX *const context = cipher(noise->key, 1);
    seal_with(context, ZERO, noise->hash, KEY_BYTES, body, bytes);
    EVP_CIPHER_CTX_free(context);
    mix_hash(noise, body, bytes + TAG_BYTES);
}

static void make_mac(const uint8_t *numbers, const uint8_t *message, size_t bytes, uint8_t *mac)
{
    size_t length = MAC_BYTES, written;
    uint8_t input[8 + MOST_BYTES];
    memcpy(input, numbers, 8);
    memcpy(input + 8, message, bytes);
    const OSSL_PARAM parameters[] = {OSSL_PARAM_size_t(OSSL_MAC_PARAM_SIZE, &length), OSSL_PARAM_END};
    must(EVP_Q_mac(NULL, "BLAKE2SMAC", NULL, NULL, parameters, mac_key, KEY_BYTES, input, 8 + bytes, mac, MAC_BYTES,
                   &written) != NULL);
}

void noise_write(struct noise *to, uint32_t nonce, const uint8_t *request, size_t bytes, uint8_t *message, uint8_t *mac)
{
    uint8_t secret[KEY_BYTES], numbers[8], prologue[sizeof PROLOGUE - 1 + sizeof numbers];
    size_t size = KEY_BYTES;
    store_u32(numbers, nonce);
    store_u32(numbers + 4, 0); /* the sequence of the HELLO */
    memcpy(prologue, PROLOGUE, sizeof PROLOGUE - 1);
    memcpy(prologue + sizeof PROLOGUE - 1, numbers, sizeof numbers);
    hash2(to->chain, NAME, sizeof NAME - 1, NULL, 0);
    memcpy(to->hash, to->chain, KEY_BYTES);
    mix_hash(to, prologue, sizeof prologue);
    mix_hash(to, peer_public, KEY_BYTES);

    EVP_PKEY_free(to->ephemeral);
    to->ephemeral = EVP_PKEY_Q_keygen(NULL, NULL, "X25519");
    must(to->ephemeral && EVP_PKEY_get_raw_public_key(to->ephemeral, message, &size));
    mix_hash(to, message, KEY_BYTES); /* e, into the key as well: section 9.2 */
    mix_key(to, message);
    must(!shared_secret(to->ephemeral, peer, secret)); /* es */
    mix_key(to, secret);
    memcpy(message + KEY_BYTES, own_public, KEY_BYTES); /* s */
    encrypt(to, message + KEY_BYTES, KEY_BYTES);
    must(!shared_secret(own, peer, secret)); /* ss */
    mix_key(to, secret);
    memcpy(message + 2 * KEY_BYTES + TAG_BYTES, request, bytes);
    encrypt(to, message + 2 * KEY_BYTES + TAG_BYTES, bytes);
    make_mac(numbers, message, bytes + NOISE1_MORE, mac);
}

int noise_read(struct noise *from, const uint8_t *message, size_t bytes, uint8_t *payload, struct seal *seal)
{
    uint8_t secret[KEY_BYTES], outputs[3][KEY_BYTES];
    if (bytes < NOISE2_MORE)
        return -1;
    struct noise noise = *from; /* a message that does not open changes nothing */
    EVP_PKEY *const theirs = EVP_PKEY_new_raw_public_key(EVP_PKEY_X25519, NULL, message, KEY_BYTES);
    mix_hash(&noise, message, KEY_BYTES); /* e */
    mix_key(&noise, message);
    int bad = !theirs || shared_secret(noise.ephemeral, theirs, secret); /* ee */
    if (!bad) {
        mix_key(&noise, secret);
        bad = shared_secret(own, theirs, secret); /* se */
        mix_key(&noise, secret);
    }
    EVP_PKEY_free(theirs);
    if (bad)
        return -1;
    derive(noise.chain, psk, KEY_BYTES, outputs, 3); /* psk */
    memcpy(noise.chain, outputs[0], KEY_BYTES);
    mix_hash(&noise, outputs[1], KEY_BYTES);
    memcpy(payload, message + KEY_BYTES, bytes - KEY_BYTES);
    EVP_CIPHER_CTX *const context = cipher(outputs[2], 0);
    bad = open_with(context, ZERO, noise.hash, KEY_BYTES, payload, bytes - KEY_BYTES);
    EVP_CIPHER_CTX_free(context);
    if (bad)
        return -1;
    derive(noise.chain, NULL, 0, outputs, 2); /* split */
    seal->send = cipher(outputs[0], 1);
    seal->receive = cipher(outputs[1], 0);
    EVP_PKEY_free(from->ephemeral);
    from->ephemeral = NULL;
    return 0;
}

static void make_nonce(uint8_t *nonce, uint32_t sequence)
{
    memset(nonce, 0, 12);
    for (int i = 0; i < 4; i++)
        nonce[4 + i] = (uint8_t)(sequence >> 8 * i);
}

void seal_close(struct seal *seal, uint32_t sequence, const uint8_t *head, size_t head_bytes, uint8_t *body, size_t bytes)
{
    uint8_t nonce[12];
    make_nonce(nonce, sequence);
    seal_with(seal->send, nonce, head, head_bytes, body, bytes);
}

int seal_open(struct seal *seal, uint32_t sequence, const uint8_t *head, size_t head_bytes, uint8_t *body, size_t bytes)
{
    uint8_t nonce[12];
    make_nonce(nonce, sequence);
    return open_with(seal->receive, nonce, head, head_bytes, body, bytes);
}
