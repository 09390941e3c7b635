/* Sealed sessions: docs/refer/protocol.md, "Sealed sessions". They need libcrypto of OpenSSL 3, or another
 * library with the primitives of crypto.h. */
#ifndef HAPTICNET_SEALED_H
#define HAPTICNET_SEALED_H

#include "hapticnet.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef uint8_t hn_key[32];

/* The keys of one granted session: those of the epochs of both directions. */
typedef struct {
    hn_key send, receive, behind, ahead;
    uint32_t send_epoch, receive_epoch;
    bool has_behind, has_ahead;
} hn_transport;

/* The keys of a master. Its fields are the library's own; overwrite it when the master is no longer needed. */
typedef struct {
    hn_key own_private, own_public, slave_public, psk, static_shared;
    bool has_psk;
    hn_key ephemeral, chain, hash, cipher; /* of the handshake under way */
    uint8_t noise1[512], mac[16];
    size_t noise1_size;
    hn_transport granted, transports[2];
} hn_master_keys;

/* Let a master, after its init, ask for sealed sessions only: with its private key, the slave's public key and, unless
 * NULL, a key that both share. Return NULL or what is wrong. `keys` stays where it is. */
const char *hn_master_seal(hn_master *m, hn_master_keys *keys, const hn_key own_private, const hn_key slave_public,
                           const uint8_t *psk);

/* A master that a slave serves, and the key that both share, or zeros. */
typedef struct {
    hn_key public_key, psk;
} hn_listed;

/* The keys of a slave; as those of a master. */
typedef struct {
    hn_key own_private, own_public;
    const hn_listed *listed;
    size_t count;
    hn_key theirs, ephemeral, chain, hash, cipher, psk; /* of the handshake under way */
    uint8_t noise2[512];                                /* the answer to it */
    size_t noise2_size;
    hn_transport granted, transports[2]; /* of the session, and of the half-open one */
} hn_slave_keys;

/* Let a slave, after its init, serve sealed sessions only, of the listed masters. Return NULL or what is wrong. `keys`
 * and `listed` stay. */
const char *hn_slave_seal(hn_slave *s, hn_slave_keys *keys, const hn_key own_private, const hn_listed *listed,
                          size_t count);

#ifdef __cplusplus
}
#endif

#endif
