#include <openssl/core_names.h>
#include <openssl/evp.h>
#include <openssl/hmac.h>

#include "crypto.h"

bool hn_public_of(uint8_t public_key[HN_KEY_BYTES], const uint8_t private_key[HN_KEY_BYTES])
{
    size_t size = HN_KEY_BYTES;
    EVP_PKEY *ours = EVP_PKEY_new_raw_private_key(EVP_PKEY_X25519, NULL, private_key, HN_KEY_BYTES);
    bool good = ours != NULL && EVP_PKEY_get_raw_public_key(ours, public_key, &size) == 1;
    EVP_PKEY_free(ours);
    return good;
}

bool hn_shared_secret(uint8_t secret[HN_KEY_BYTES], const uint8_t private_key[HN_KEY_BYTES],
                      const uint8_t public_key[HN_KEY_BYTES])
{
    size_t size = HN_KEY_BYTES;
    EVP_PKEY *ours = EVP_PKEY_new_raw_private_key(EVP_PKEY_X25519, NULL, private_key, HN_KEY_BYTES);
    EVP_PKEY *theirs = EVP_PKEY_new_raw_public_key(EVP_PKEY_X25519, NULL, public_key, HN_KEY_BYTES);
    EVP_PKEY_CTX *derives = ours == NULL ? NULL : EVP_PKEY_CTX_new(ours, NULL);
    bool good = derives != NULL && theirs != NULL && EVP_PKEY_derive_init(derives) == 1 &&
                EVP_PKEY_derive_set_peer(derives, theirs) == 1 && EVP_PKEY_derive(derives, secret, &size) == 1;
    EVP_PKEY_CTX_free(derives);
    EVP_PKEY_free(theirs);
    EVP_PKEY_free(ours);
    return good;
}

bool hn_hash(uint8_t digest[HN_KEY_BYTES], const void *first, size_t first_size, const void *second,
             size_t second_size)
{
    EVP_MD_CTX *hash = EVP_MD_CTX_new();
    bool good = hash != NULL && EVP_DigestInit_ex(hash, EVP_blake2s256(), NULL) == 1 &&
                EVP_DigestUpdate(hash, first, first_size) == 1 && EVP_DigestUpdate(hash, second, second_size) == 1 &&
                EVP_DigestFinal_ex(hash, digest, NULL) == 1;
    EVP_MD_CTX_free(hash);
    return good;
}

bool hn_hmac(uint8_t digest[HN_KEY_BYTES], const uint8_t key[HN_KEY_BYTES], const void *data, size_t size)
{
    return HMAC(EVP_blake2s256(), key, HN_KEY_BYTES, data, size, digest, NULL) != NULL;
}

bool hn_mac(uint8_t mac[16], const uint8_t key[HN_KEY_BYTES], const void *data, size_t size)
{
    size_t length = 16;
    OSSL_PARAM wanted[] = {OSSL_PARAM_construct_size_t(OSSL_MAC_PARAM_SIZE, &length), OSSL_PARAM_construct_end()};
    EVP_MAC *kind = EVP_MAC_fetch(NULL, "BLAKE2SMAC", NULL);
    EVP_MAC_CTX *makes = kind == NULL ? NULL : EVP_MAC_CTX_new(kind);
    bool good = makes != NULL && EVP_MAC_init(makes, key, HN_KEY_BYTES, wanted) == 1 &&
                EVP_MAC_update(makes, data, size) == 1 && EVP_MAC_final(makes, mac, &length, length) == 1;
    EVP_MAC_CTX_free(makes);
    EVP_MAC_free(kind);
    return good;
}

bool hn_seal(uint8_t *sealed, const uint8_t key[HN_KEY_BYTES], const uint8_t nonce[HN_NONCE_BYTES], const void *head,
             size_t head_size, const void *plain, size_t size)
{
    int length;
    EVP_CIPHER_CTX *cipher = EVP_CIPHER_CTX_new();
    bool good = cipher != NULL && EVP_EncryptInit_ex(cipher, EVP_chacha20_poly1305(), NULL, key, nonce) == 1 &&
                EVP_EncryptUpdate(cipher, NULL, &length, head, (int)head_size) == 1 &&
                EVP_EncryptUpdate(cipher, sealed, &length, plain, (int)size) == 1 &&
                EVP_EncryptFinal_ex(cipher, sealed + size, &length) == 1 &&
                EVP_CIPHER_CTX_ctrl(cipher, EVP_CTRL_AEAD_GET_TAG, HN_TAG_BYTES, sealed + size) == 1;
    EVP_CIPHER_CTX_free(cipher);
    return good;
}

bool hn_open(uint8_t *plain, const uint8_t key[HN_KEY_BYTES], const uint8_t nonce[HN_NONCE_BYTES], const void *head,
             size_t head_size, const void *sealed, size_t size)
{
    int length;
    if (size < HN_TAG_BYTES)
        return false;
    size -= HN_TAG_BYTES;
    uint8_t tag[HN_TAG_BYTES];
    for (size_t i = 0; i < sizeof tag; i++)
        tag[i] = ((const uint8_t *)sealed)[size + i];
    EVP_CIPHER_CTX *cipher = EVP_CIPHER_CTX_new();
    bool good = cipher != NULL && EVP_DecryptInit_ex(cipher, EVP_chacha20_poly1305(), NULL, key, nonce) == 1 &&
                EVP_DecryptUpdate(cipher, NULL, &length, head, (int)head_size) == 1 &&
                EVP_DecryptUpdate(cipher, plain, &length, sealed, (int)size) == 1 &&
                EVP_CIPHER_CTX_ctrl(cipher, EVP_CTRL_AEAD_SET_TAG, HN_TAG_BYTES, tag) == 1 &&
                EVP_DecryptFinal_ex(cipher, plain + size, &length) == 1;
    EVP_CIPHER_CTX_free(cipher);
    return good;
}
