/** The seven functions of `peers/c/sealed/crypto.h` over audited libraries: no primitive is our own. */
import { chacha20poly1305 } from "@noble/ciphers/chacha";
import { x25519 } from "@noble/curves/ed25519";
import { blake2s } from "@noble/hashes/blake2s";
import { hmac } from "@noble/hashes/hmac";

const KEY_BYTES = 32;
const NONCE_BYTES = 12;
/** BLAKE2s for `hmac`, whose type does not allow options. */
const hash = blake2s as unknown as Parameters<typeof hmac>[0];

/** Compute the public key of a private one, both 32 bytes. @internal */
export function x25519Public(privateKey: Uint8Array): Uint8Array {
  return x25519.getPublicKey(privateKey);
}

/** Compute the secret of two keys; throws if the public one is of low order. @internal */
export function x25519Secret(privateKey: Uint8Array, publicKey: Uint8Array): Uint8Array {
  return x25519.getSharedSecret(privateKey, publicKey);
}

/** Hash some bytes to 28 bytes, which stand for an address. @internal */
export function shorten(data: Uint8Array): Uint8Array {
  return blake2s(data, { dkLen: 28 });
}

/** Make the functions that the library calls, on the memory that `view` shows: `view(at, size)`. @internal */
export function primitives(view: (at: number, size: number) => Uint8Array): Record<string, CallableFunction> {
  const key = (at: number) => view(at, KEY_BYTES);
  /** Write what a function computes; return whether it could. */
  const write = (at: number, compute: () => Uint8Array): boolean => {
    try {
      const result = compute();
      view(at, result.length).set(result);
      return true;
    } catch {
      return false; // a point of low order, or a datagram that is not genuine
    }
  };
  const cipher = (keyAt: number, nonceAt: number, head: number, headSize: number) =>
    chacha20poly1305(key(keyAt), view(nonceAt, NONCE_BYTES), view(head, headSize));

  return {
    hn_public_of: (to: number, privateAt: number) => write(to, () => x25519Public(key(privateAt))),
    hn_shared_secret: (to: number, privateAt: number, publicAt: number) =>
      write(to, () => x25519Secret(key(privateAt), key(publicAt))),
    hn_hash: (to: number, first: number, firstSize: number, second: number, secondSize: number) =>
      write(to, () => blake2s.create({}).update(view(first, firstSize)).update(view(second, secondSize)).digest()),
    hn_hmac: (to: number, keyAt: number, data: number, size: number) =>
      write(to, () => hmac(hash, key(keyAt), view(data, size))),
    hn_mac: (to: number, keyAt: number, data: number, size: number) =>
      write(to, () => blake2s(view(data, size), { key: key(keyAt), dkLen: 16 })),
    hn_seal: (to: number, keyAt: number, nonceAt: number, head: number, headSize: number, data: number, size: number) =>
      write(to, () => cipher(keyAt, nonceAt, head, headSize).encrypt(view(data, size))),
    hn_open: (to: number, keyAt: number, nonceAt: number, head: number, headSize: number, data: number, size: number) =>
      write(to, () => cipher(keyAt, nonceAt, head, headSize).decrypt(view(data, size))),
  };
}
