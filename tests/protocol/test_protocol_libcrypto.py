"""OpenSSL for compiled functions: contexts are freed once, and machine code finds the library in every process."""

import gc
import os
import subprocess
import sys

import numpy as np
import pytest

from hapticnet.compiled import fast_extra_installed
from hapticnet.errors import UnavailableError
from hapticnet.protocol import libcrypto
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.seal_steps import COLUMNS, RowSeal

ONE = bytes(range(32))
OTHER = bytes(range(32, 64))


@pytest.fixture(autouse=True, scope="module")
def library(tool_is_missing):
    if libcrypto.version() is None:
        tool_is_missing("libcrypto of OpenSSL 3")


def test_contexts_are_freed_once(monkeypatch):
    freed = []
    library = libcrypto._library()
    free = library.EVP_CIPHER_CTX_free

    def counted(address):
        freed.append(address)
        free(address)

    monkeypatch.setattr(library, "EVP_CIPHER_CTX_free", counted)
    row = np.zeros(COLUMNS, np.int64)
    seal = Seal(ONE, OTHER)
    keeper = RowSeal(seal, row)
    made = sorted(row[:2].tolist())
    assert not freed
    keeper.release(row)
    keeper.release(row)
    assert sorted(freed) == made
    with pytest.raises(ValueError, match="freed"):
        keeper._seals.set_key(ONE)
    del keeper
    gc.collect()
    assert len(freed) == 2
    RowSeal(seal, row)  # without a reference to it
    gc.collect()
    assert len(freed) == 4


def test_a_key_has_32_bytes():
    with pytest.raises(ValueError, match="key of 31 bytes; it must have 32"):
        libcrypto.Context(bytes(31), seals=True)


def test_without_libcrypto_nothing_is_made_and_rows_leave_everything_to_the_seal(monkeypatch):
    monkeypatch.setattr(libcrypto, "_library", lambda: None)
    assert libcrypto.version.__wrapped__() is None
    with pytest.raises(UnavailableError, match="no OpenSSL 3"):
        RowSeal(Seal(ONE, OTHER), np.zeros(COLUMNS, np.int64))
    missing = libcrypto._foreign("EVP_EncryptFinal_ex")
    assert missing.address
    assert missing(1, 2, 3) == 0


ANOTHER_PROCESS = """
import sys
import numpy as np
from hapticnet.compiled import compiled
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.seal_steps import COLUMNS, RowSeal, seal_body
row = np.zeros(COLUMNS, np.int64)
keeper = RowSeal(Seal(bytes(range(32)), bytes(32)), row)
out = np.zeros(100, np.uint8)
end = compiled(seal_body)(row, out, 0, 10, np.zeros(20, np.uint8), 0, 20, 7)
print(out[:end].tobytes().hex(), sum(compiled(seal_body).stats.cache_hits.values()))
"""


def test_machine_code_is_kept_for_the_next_process(tmp_path, tool_is_missing):
    """Addresses of libcrypto differ from process to process; machine code must find them by name."""
    if not fast_extra_installed():
        tool_is_missing("numba")
    settings = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    settings.pop("NUMBA_CACHE_DIR", None)
    first, second = (
        subprocess.run(
            [sys.executable, "-c", ANOTHER_PROCESS], env=settings, capture_output=True, text=True, check=True
        )
        for _ in range(2)
    )
    (sealed, hits), (again, later_hits) = first.stdout.split(), second.stdout.split()
    assert sealed == again
    assert (hits, later_hits) == ("0", "1")
