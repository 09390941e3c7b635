/** Keys of sealed sessions, as `hapticnet key` writes them: 32 bytes, written as 44 characters of base64. */
import { x25519Public, x25519Secret } from "./crypto.js";

const KEY_BYTES = 32;
const KEY_CHARACTERS = 44;

/** A key: 32 bytes, or the 44 characters of base64 that `hapticnet key` prints. */
export type Key = Uint8Array | string;

/** A host's own key, as in the file `key.toml` of `hapticnet key new`. */
export interface KeyFile {
  /** X25519 private key. */
  readonly private: Uint8Array;
  /** Key that a master shares with its slave, if there is one. */
  readonly psk?: Uint8Array;
}

/**
 * Return the 32 bytes of a key.
 *
 * @param key - the key, which no error shows
 * @param name - what an error calls it
 * @throws RangeError if it is not a key
 */
export function parseKey(key: Key, name = "the key"): Uint8Array {
  if (typeof key !== "string") {
    if (key instanceof Uint8Array && key.length === KEY_BYTES) return key.slice();
    throw new RangeError(`${name} must be a Uint8Array of ${KEY_BYTES} bytes, or base64`);
  }
  const text = key.trim();
  let bytes = new Uint8Array();
  try {
    bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  } catch {
    // it is no base64: the error below says so
  }
  if (bytes.length === KEY_BYTES && formatKey(bytes) === text) return bytes;
  throw new RangeError(
    `${name} has ${text.length} characters that are no key; a key is ${KEY_CHARACTERS} characters of base64 that end in '='`,
  );
}

/** Return a key as 44 characters of base64. */
export function formatKey(key: Uint8Array): string {
  return btoa(String.fromCharCode(...key));
}

/** Return a new private key. */
export function newKey(): Uint8Array {
  return crypto.getRandomValues(new Uint8Array(KEY_BYTES));
}

/** Return the public key of a private one; RangeError if that is not a key. */
export function publicKey(privateKey: Key): Uint8Array {
  return x25519Public(parseKey(privateKey, "the private key"));
}

/**
 * Read a key file of `hapticnet key new`: lines `private = "…"` and maybe `psk = "…"`.
 *
 * @throws RangeError if a key is missing or wrong
 */
export function parseKeyFile(toml: string): KeyFile {
  const found: { private?: Uint8Array; psk?: Uint8Array } = {};
  for (const line of toml.split("\n")) {
    const [, name, value] = /^\s*(private|psk)\s*=\s*["']([^"']*)["']\s*(?:#.*)?$/.exec(line) ?? [];
    if (name === "private" || name === "psk") found[name] = parseKey(value ?? "", name);
  }
  if (found.private === undefined) throw new RangeError("the key file has no line: private = \"<44 characters of base64>\"");
  return found as KeyFile;
}

/** Check that X25519 gives a secret with a public key; RangeError if it is of low order. */
export function checkPublic(key: Uint8Array, name: string): void {
  try {
    x25519Secret(new Uint8Array(KEY_BYTES), key);
  } catch {
    throw new RangeError(`${name} is not a public key; no private key belongs to it`);
  }
}
