"""ChaCha20-Poly1305 of OpenSSL, for compiled functions (`protocol.seal_steps`).

The package `cryptography` has it for Python only. Here is the libcrypto that Python's own `ssl` uses, or else the
system's. Where there is neither, or one older than 3.0, `version` is None and compiled functions cannot seal.
"""

import ctypes
import sys
import weakref
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from typing import Any, Final

from hapticnet.compiled import Foreign
from hapticnet.errors import UnavailableError

_OLDEST: Final = 0x30000000
"""OpenSSL 3.0.0 (OpenSSL_version_num(3)). LibreSSL and BoringSSL give lower numbers."""

KEY_BYTES: Final = 32


class Context:
    """An EVP_CIPHER_CTX under one key, which seals or opens. It is used by one thread at a time.

    Raises
    ------
    UnavailableError
        If there is no libcrypto, or it has no ChaCha20-Poly1305.
    """

    def __init__(self, key: bytes, *, seals: bool) -> None:
        library = _library()
        address = library.EVP_CIPHER_CTX_new() if library else None
        if library is None or address is None:
            raise UnavailableError("no OpenSSL 3 was found that compiled functions can use")
        self.address: int = address
        """Address of the EVP_CIPHER_CTX; not to be used after `free`."""
        # Called once, by `free` or when the last reference goes. At the end of the process there is no need to.
        self._free = weakref.finalize(self, library.EVP_CIPHER_CTX_free, address)
        self._free.atexit = False
        self._init = library.EVP_EncryptInit_ex if seals else library.EVP_DecryptInit_ex
        self._start(library.EVP_chacha20_poly1305(), key)

    def set_key(self, key: bytes) -> None:
        """Replace the key (32 bytes)."""
        if not self._free.alive:
            raise ValueError("the context was freed; make another one")
        self._start(None, key)

    def free(self) -> None:
        """Erase the key and free the memory; a second call does nothing."""
        self._free()

    def _start(self, cipher: int | None, key: bytes) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"key of {len(key)} bytes; it must have {KEY_BYTES}")
        if self._init(self.address, cipher, None, key, None) != 1:
            self.free()
            raise UnavailableError("OpenSSL has no ChaCha20-Poly1305 here")


@cache
def version() -> str | None:
    """Return the name and version of the libcrypto that compiled functions can use, None if there is none."""
    library = _library()
    if library is None:
        return None
    with suppress(UnavailableError):  # one that is restricted to FIPS algorithms
        Context(bytes(KEY_BYTES), seals=True).free()
        name: bytes = library.OpenSSL_version(0)
        return name.decode(errors="replace")
    return None


@cache
def _library() -> Any:
    """Return libcrypto with the types of its functions, None if there is none that fits."""
    ssl = find_spec("_ssl")
    # Symbols are also looked for in what `_ssl` was linked with. Where `_ssl` is part of Python, they may be missing.
    for file in (ssl and ssl.has_location and ssl.origin, "libcrypto.so.3" if sys.platform == "linux" else None):
        with suppress(OSError, AttributeError):
            if file:
                library = ctypes.CDLL(file)
                _declare(library)
                if library.OpenSSL_version_num() >= _OLDEST:
                    return library
    return None


def _declare(library: ctypes.CDLL) -> None:
    """Say what the functions take and return; AttributeError if one is missing."""
    pointer = ctypes.c_void_p
    library.OpenSSL_version_num.restype = ctypes.c_ulong
    library.OpenSSL_version.restype = ctypes.c_char_p
    library.EVP_chacha20_poly1305.restype = pointer
    library.EVP_CIPHER_CTX_new.restype = pointer
    library.EVP_CIPHER_CTX_free.argtypes = [pointer]
    library.EVP_CIPHER_CTX_free.restype = None
    for name, arguments in _CALLED.items():
        getattr(library, name).argtypes = [pointer if each == "p" else ctypes.c_int for each in arguments]


_CALLED: Final = {
    "EVP_EncryptInit_ex": "ppppp",
    "EVP_EncryptUpdate": "ppppi",
    "EVP_EncryptFinal_ex": "ppp",
    "EVP_DecryptInit_ex": "ppppp",
    "EVP_DecryptUpdate": "ppppi",
    "EVP_DecryptFinal_ex": "ppp",
    "EVP_CIPHER_CTX_ctrl": "piip",
}
"""What compiled functions call, with the letters of `Foreign`. All return 1 if they succeed."""

_fails = ctypes.CFUNCTYPE(ctypes.c_int)(lambda: 0)
"""Takes the place of missing functions, so that compiled ones can be loaded. Without contexts nothing calls it."""


def _foreign(name: str) -> Foreign:
    """Return a function of libcrypto under a name of our own: a process may contain several OpenSSLs."""
    function = getattr(_library(), name, _fails)
    address = ctypes.cast(function, ctypes.c_void_p).value or 0
    return Foreign(f"hapticnet_{name}", _CALLED[name], address, function)


encrypt_init = _foreign("EVP_EncryptInit_ex")
encrypt_update = _foreign("EVP_EncryptUpdate")
encrypt_final = _foreign("EVP_EncryptFinal_ex")
decrypt_init = _foreign("EVP_DecryptInit_ex")
decrypt_update = _foreign("EVP_DecryptUpdate")
decrypt_final = _foreign("EVP_DecryptFinal_ex")
context_ctrl = _foreign("EVP_CIPHER_CTX_ctrl")

SET_TAG: Final = 0x11
"""EVP_CTRL_AEAD_SET_TAG of openssl/evp.h."""

GET_TAG: Final = 0x10
"""EVP_CTRL_AEAD_GET_TAG."""
