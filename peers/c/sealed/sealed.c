/* Both halves of Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s (revision 34), and the seal of sessions. */
#include <string.h>

#include "crypto.h"
#include "hapticnet_sealed.h"
#include "messages.h"

static const char NO_X25519[] = "libcrypto lacks X25519, as in FIPS mode";

enum { NOISE1_BYTES = 2 * HN_KEY_BYTES + 2 * HN_TAG_BYTES, NOISE2_BYTES = HN_KEY_BYTES + HN_TAG_BYTES };

static void store32(uint8_t *at, uint32_t number)
{
    for (unsigned i = 0; i < 4; i++)
        at[i] = (uint8_t)(number >> 8 * (3 - i));
}

/* Handshake: the state is chain, hash and cipher (section 5.2). Every key encrypts once, so each nonce is zero. */

static const uint8_t ZERO_NONCE[HN_NONCE_BYTES];

typedef struct {
    uint8_t *chain, *hash, *cipher;
} transcript;

#define OF(k) ((transcript){(k)->chain, (k)->hash, (k)->cipher})

static bool mix_hash(transcript k, const void *data, size_t size)
{
    return hn_hash(k.hash, k.hash, HN_KEY_BYTES, data, size);
}

/* Derive `count` keys, 2 or 3, from the chain and some material (section 4.3). */
static bool derive(const hn_key chain, const void *material, size_t size, unsigned count, hn_key out[3])
{
    hn_key secret;
    uint8_t data[HN_KEY_BYTES + 1] = {1};
    bool good = hn_hmac(secret, chain, material, size) && hn_hmac(out[0], secret, data, 1);
    for (unsigned i = 1; i < count && good; i++) {
        memcpy(data, out[i - 1], HN_KEY_BYTES);
        data[HN_KEY_BYTES] = (uint8_t)(i + 1);
        good = hn_hmac(out[i], secret, data, sizeof data);
    }
    return good;
}

static bool mix_key(transcript k, const hn_key material)
{
    hn_key out[3];
    if (!derive(k.chain, material, HN_KEY_BYTES, 2, out))
        return false;
    memcpy(k.chain, out[0], HN_KEY_BYTES);
    memcpy(k.cipher, out[1], HN_KEY_BYTES);
    return true;
}

static bool mix_secret(transcript k, const hn_key private_key, const hn_key public_key)
{
    hn_key secret;
    return hn_shared_secret(secret, private_key, public_key) && mix_key(k, secret);
}

static bool mix_psk(transcript k, const hn_key psk)
{
    hn_key out[3];
    if (!derive(k.chain, psk, HN_KEY_BYTES, 3, out))
        return false;
    memcpy(k.chain, out[0], HN_KEY_BYTES);
    memcpy(k.cipher, out[2], HN_KEY_BYTES);
    return mix_hash(k, out[1], HN_KEY_BYTES);
}

static bool encrypt(transcript k, uint8_t *sealed, const void *plain, size_t size)
{
    return hn_seal(sealed, k.cipher, ZERO_NONCE, k.hash, HN_KEY_BYTES, plain, size) &&
           mix_hash(k, sealed, size + HN_TAG_BYTES);
}

static bool decrypt(transcript k, uint8_t *plain, const uint8_t *sealed, size_t size)
{
    return hn_open(plain, k.cipher, ZERO_NONCE, k.hash, HN_KEY_BYTES, sealed, size) && mix_hash(k, sealed, size);
}

static bool mix_ephemeral(transcript k, const hn_key public_key)
{
    return mix_hash(k, public_key, HN_KEY_BYTES) && mix_key(k, public_key);
}

static bool begin_handshake(transcript k, const hn_key slave_public, uint32_t nonce, uint32_t sequence)
{
    static const char name[] = "Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s";
    uint8_t prologue[19] = "hapticnet 2"; /* and the nonce, and the sequence of the HELLO */
    store32(prologue + 11, nonce);
    store32(prologue + 15, sequence);
    return hn_hash(k.chain, name, sizeof name - 1, NULL, 0) &&
           hn_hash(k.hash, k.chain, HN_KEY_BYTES, prologue, sizeof prologue) && mix_hash(k, slave_public, HN_KEY_BYTES);
}

/* The code that shows that a master knows the slave's public key */
static bool write_mac(uint8_t mac[16], const hn_key slave_public, uint32_t nonce, uint32_t sequence,
                      const uint8_t *noise1, size_t size)
{
    uint8_t data[8 + HN_DATAGRAM_BYTES];
    hn_key label;
    if (size > HN_DATAGRAM_BYTES)
        return false;
    store32(data, nonce);
    store32(data + 4, sequence);
    memcpy(data + 8, noise1, size);
    return hn_hash(label, "hapticnet mac1", 14, slave_public, HN_KEY_BYTES) && hn_mac(mac, label, data, 8 + size);
}

static bool split(transcript k, hn_key first, hn_key second)
{
    hn_key out[3];
    if (!derive(k.chain, NULL, 0, 2, out))
        return false;
    memcpy(first, out[0], HN_KEY_BYTES);
    memcpy(second, out[1], HN_KEY_BYTES);
    return true;
}

/* The master */

/* -> e, es, s, ss */
static bool write_noise1(hn_master_keys *k, uint32_t nonce, const uint8_t *request, size_t size)
{
    transcript t = OF(k);
    uint8_t *at = k->noise1 + HN_KEY_BYTES;
    k->noise1_size = NOISE1_BYTES + size;
    return k->noise1_size <= sizeof k->noise1 && begin_handshake(t, k->slave_public, nonce, 0) &&
           hn_public_of(k->noise1, k->ephemeral) && mix_ephemeral(t, k->noise1) &&
           mix_secret(t, k->ephemeral, k->slave_public) && encrypt(t, at, k->own_public, HN_KEY_BYTES) &&
           mix_key(t, k->static_shared) && encrypt(t, at + HN_KEY_BYTES + HN_TAG_BYTES, request, size) &&
           write_mac(k->mac, k->slave_public, nonce, 0, k->noise1, k->noise1_size);
}

/* <- e, ee, se, psk. It changes `k` only if all is well. */
static bool read_noise2(hn_master_keys *k, const hn_key psk, hn_bytes noise2, uint8_t *plain)
{
    hn_master_keys next = *k;
    transcript t = OF(&next);
    if (noise2.size < NOISE2_BYTES || !mix_ephemeral(t, noise2.at) || !mix_secret(t, next.ephemeral, noise2.at) ||
        !mix_secret(t, next.own_private, noise2.at) || !mix_psk(t, psk) ||
        !decrypt(t, plain, noise2.at + HN_KEY_BYTES, noise2.size - HN_KEY_BYTES))
        return false;
    memset(&k->granted, 0, sizeof k->granted);
    return split(t, k->granted.send, k->granted.receive);
}

static bool is_refusal(hn_bytes packed)
{
    hn_reader r = hn_read_from(packed);
    hn_get_array(&r, 1);
    return hn_get_uint32(&r) == 0 && r.ok;
}

/* Open the answer to the last HELLO. A slave that does not know this key can refuse without the psk, but not grant. */
static size_t read_answer(void *keys, const uint8_t *noise2, size_t size, uint8_t *plain)
{
    static const hn_key no_psk;
    hn_master_keys *k = keys;
    hn_bytes sealed = {noise2, size}, opened = {plain, size - NOISE2_BYTES};
    if (read_noise2(k, k->psk, sealed, plain))
        return opened.size;
    if (!k->has_psk || !read_noise2(k, no_psk, sealed, plain) || !is_refusal(opened))
        return 0;
    return opened.size;
}

static void use(void *keys, unsigned stream)
{
    hn_master_keys *k = keys;
    k->transports[stream] = k->granted;
}

/* Sessions */

static void nonce_of(uint8_t nonce[HN_NONCE_BYTES], uint64_t number)
{
    memset(nonce, 0, 4);
    for (unsigned i = 0; i < 8; i++)
        nonce[4 + i] = (uint8_t)(number >> 8 * i);
}

/* Give the key of the next epoch: REKEY (section 4.2). */
static bool rekey(hn_key next, const hn_key key)
{
    static const hn_key zeros;
    uint8_t nonce[HN_NONCE_BYTES], sealed[HN_KEY_BYTES + HN_TAG_BYTES];
    nonce_of(nonce, UINT64_MAX);
    if (!hn_seal(sealed, key, nonce, NULL, 0, zeros, sizeof zeros))
        return false;
    memcpy(next, sealed, HN_KEY_BYTES);
    return true;
}

/* Seal a datagram of an open session in place: it stays the same but for version and body. */
static size_t seal_with(hn_transport *t, uint8_t *data, size_t size)
{
    uint8_t nonce[HN_NONCE_BYTES], plain[HN_DATAGRAM_BYTES];
    hn_frame frame;
    if (!hn_read_frame((hn_bytes){data, size}, &frame) || frame.body.size + HN_TAG_BYTES > HN_DATAGRAM_BYTES)
        return 0;
    for (; t->send_epoch < frame.sequence >> HN_EPOCH_BITS; t->send_epoch++)
        if (!rekey(t->send, t->send))
            return 0;
    size_t head = (size_t)(frame.body.at - data) - (frame.body.size <= UINT8_MAX ? 2 : 3);
    size_t body = frame.body.size + HN_TAG_BYTES, start = head + (body <= UINT8_MAX ? 2 : 3);
    if (start + body > HN_DATAGRAM_BYTES)
        return 0;
    memcpy(plain, frame.body.at, frame.body.size);
    data[1] = 2;
    data[head] = body <= UINT8_MAX ? 0xc4 : 0xc5;
    data[start - 1] = (uint8_t)body;
    if (body > UINT8_MAX)
        data[start - 2] = (uint8_t)(body >> 8);
    nonce_of(nonce, frame.sequence);
    return hn_seal(data + start, t->send, nonce, data, head, plain, frame.body.size) ? start + body : 0;
}

/* Open the body of a datagram into `plain`; return whether it is genuine. The head of its body must be the shortest. */
static bool open_with(hn_transport *t, const uint8_t *data, size_t size, uint32_t sequence, size_t body, uint8_t *plain)
{
    uint8_t nonce[HN_NONCE_BYTES];
    uint32_t epoch = sequence >> HN_EPOCH_BITS;
    size_t head = size - body - (body <= UINT8_MAX ? 2 : 3);
    const uint8_t *sealed = data + size - body;
    nonce_of(nonce, sequence);
    if (epoch == t->receive_epoch)
        return hn_open(plain, t->receive, nonce, data, head, sealed, body);
    if (epoch + 1 == t->receive_epoch && t->has_behind)
        return hn_open(plain, t->behind, nonce, data, head, sealed, body);
    if (epoch != t->receive_epoch + 1)
        return false;
    t->has_ahead = t->has_ahead || rekey(t->ahead, t->receive); /* kept: each of a flood must not derive a key */
    if (!t->has_ahead || !hn_open(plain, t->ahead, nonce, data, head, sealed, body))
        return false;
    memcpy(t->behind, t->receive, HN_KEY_BYTES);
    memcpy(t->receive, t->ahead, HN_KEY_BYTES);
    t->has_behind = true;
    t->has_ahead = false;
    t->receive_epoch++;
    return true;
}

static void draw(hn_key key, hn_entropy *entropy, void *context)
{
    for (unsigned i = 0; i < HN_KEY_BYTES; i += 4)
        store32(key + i, entropy(context));
}

/* What a master calls */

static void ask(hn_master *m, const uint8_t *request, size_t size)
{
    hn_master_keys *k = m->keys;
    draw(k->ephemeral, m->entropy, m->context);
    if (!write_noise1(k, m->nonce, request, size))
        k->noise1_size = 0; /* which no slave answers */
}

static void hello(void *keys, const uint8_t **noise1, size_t *size, const uint8_t **mac)
{
    hn_master_keys *k = keys;
    *noise1 = k->noise1;
    *size = k->noise1_size;
    *mac = k->mac;
}

static size_t seal_of_master(void *keys, unsigned stream, uint8_t *data, size_t size)
{
    return seal_with(&((hn_master_keys *)keys)->transports[stream], data, size);
}

static bool open_of_master(void *keys, unsigned stream, const uint8_t *data, size_t size, uint32_t sequence,
                           size_t body, uint8_t *plain)
{
    return open_with(&((hn_master_keys *)keys)->transports[stream], data, size, sequence, body, plain);
}

/* Close a master that cannot be sealed, so that it asks for nothing if its program goes on. */
static const char *closed(hn_master *m, const char *wrong)
{
    m->state = HN_CLOSED;
    m->asking = false;
    return wrong;
}

const char *hn_master_seal(hn_master *m, hn_master_keys *keys, const hn_key own_private, const hn_key slave_public,
                           const uint8_t *psk)
{
    static const hn_sealing sealing = {ask, hello, read_answer, use, seal_of_master, open_of_master};
    if (m->sealing != NULL || m->tried) /* the stream that it has would get keys of zeros */
        return "a master is sealed once, before its first tick";
    memset(keys, 0, sizeof *keys);
    memcpy(keys->own_private, own_private, HN_KEY_BYTES);
    memcpy(keys->slave_public, slave_public, HN_KEY_BYTES);
    if (psk != NULL)
        memcpy(keys->psk, psk, HN_KEY_BYTES);
    keys->has_psk = psk != NULL;
    m->sealing = &sealing;
    m->keys = keys;
    if (!hn_public_of(keys->own_public, own_private))
        return closed(m, NO_X25519);
    if (!hn_shared_secret(keys->static_shared, own_private, slave_public))
        return closed(m, "the slave's public key is none; 'hapticnet key public' prints it on the slave's host");
    return NULL;
}

/* What a slave calls */

static bool is_for_us(void *keys, uint32_t nonce, uint32_t sequence, const uint8_t *noise1, size_t size,
                      const uint8_t *mac)
{
    hn_slave_keys *k = keys;
    uint8_t wanted[16], differ = 0;
    if (!write_mac(wanted, k->own_public, nonce, sequence, noise1, size))
        return false;
    for (unsigned i = 0; i < sizeof wanted; i++) /* in a time that does not depend on the difference */
        differ |= wanted[i] ^ mac[i];
    return differ == 0;
}

/* Read the first message of a handshake; return the size of the request, or 0. */
static size_t read_noise1(void *keys, uint32_t nonce, uint32_t sequence, const uint8_t *noise1, size_t size,
                          uint8_t *plain)
{
    hn_slave_keys *k = keys;
    transcript t = OF(k);
    const uint8_t *at = noise1 + HN_KEY_BYTES;
    if (size <= NOISE1_BYTES || !begin_handshake(t, k->own_public, nonce, sequence) || !mix_ephemeral(t, noise1) ||
        !mix_secret(t, k->own_private, noise1) || !decrypt(t, k->theirs, at, HN_KEY_BYTES + HN_TAG_BYTES) ||
        !mix_secret(t, k->own_private, k->theirs) ||
        !decrypt(t, plain, at + HN_KEY_BYTES + HN_TAG_BYTES, size - 2 * HN_KEY_BYTES - HN_TAG_BYTES))
        return 0;
    memcpy(k->ephemeral, noise1, HN_KEY_BYTES); /* the master's, until the answer */
    return size - NOISE1_BYTES;
}

/* Whether the master of the handshake is listed; its psk is used from now on. */
static bool is_listed(void *keys)
{
    hn_slave_keys *k = keys;
    memset(k->psk, 0, sizeof k->psk);
    for (size_t i = 0; i < k->count; i++)
        if (memcmp(k->listed[i].public_key, k->theirs, HN_KEY_BYTES) == 0) {
            memcpy(k->psk, k->listed[i].psk, HN_KEY_BYTES);
            return true;
        }
    return false;
}

/* <- e, ee, se, psk */
static size_t write_noise2(hn_slave *s, const uint8_t *payload, size_t size, const uint8_t **noise2)
{
    hn_slave_keys *k = s->keys;
    transcript t = OF(k);
    hn_key ours;
    draw(ours, s->entropy, s->context);
    *noise2 = k->noise2;
    memset(&k->granted, 0, sizeof k->granted);
    k->noise2_size = NOISE2_BYTES + size;
    if (k->noise2_size > sizeof k->noise2 || !hn_public_of(k->noise2, ours) || !mix_ephemeral(t, k->noise2) ||
        !mix_secret(t, ours, k->ephemeral) || !mix_secret(t, ours, k->theirs) || !mix_psk(t, k->psk) ||
        !encrypt(t, k->noise2 + HN_KEY_BYTES, payload, size) || !split(t, k->granted.receive, k->granted.send))
        k->noise2_size = 0;
    return k->noise2_size;
}

static void use_of_slave(void *keys, bool half_open)
{
    hn_slave_keys *k = keys;
    if (half_open)
        k->transports[1] = k->granted;
    else
        k->transports[0] = k->transports[1];
}

static size_t seal_of_slave(void *keys, unsigned transport, uint8_t *data, size_t size)
{
    return seal_with(&((hn_slave_keys *)keys)->transports[transport], data, size);
}

static bool open_of_slave(void *keys, unsigned transport, const uint8_t *data, size_t size, uint32_t sequence,
                          size_t body, uint8_t *plain)
{
    return open_with(&((hn_slave_keys *)keys)->transports[transport], data, size, sequence, body, plain);
}

const char *hn_slave_seal(hn_slave *s, hn_slave_keys *keys, const hn_key own_private, const hn_listed *listed,
                          size_t count)
{
    static const hn_slave_sealing sealing = {is_for_us,    read_noise1,   is_listed,    write_noise2,
                                             use_of_slave, seal_of_slave, open_of_slave};
    if (s->sealing != NULL || s->next_cookie > 0) /* a session that it has would get keys of zeros */
        return "a slave is sealed once, before its first datagram";
    memset(keys, 0, sizeof *keys);
    memcpy(keys->own_private, own_private, HN_KEY_BYTES);
    s->sealing = &sealing;
    s->keys = keys;
    if (!hn_public_of(keys->own_public, own_private))
        return NO_X25519;
    keys->listed = listed;
    keys->count = count;
    return NULL;
}
