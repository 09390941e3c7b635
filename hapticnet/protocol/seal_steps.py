"""Seal and open datagrams inside compiled functions: the bytes of `protocol.seal`, under its keys.

What a session needs for that is a row of int64 numbers, of `COLUMNS` columns, contiguous. `RowSeal` fills it from a
`Seal` and keeps the contexts whose addresses it contains. A row of zeros seals and opens nothing. The compiled
functions serve the present epoch of each direction; everything else is for the `Seal`:

- Before the `Seal` packs a datagram, and when the session leaves its row, `tell` it what the row has sealed.
- After it has packed or opened one, `RowSeal.load` the row again, which is cheap while the epochs are the same.

One thread at a time may use a row.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import IntArray
from hapticnet.protocol.libcrypto import (
    GET_TAG,
    SET_TAG,
    Context,
    context_ctrl,
    decrypt_final,
    decrypt_init,
    decrypt_update,
    encrypt_final,
    encrypt_init,
    encrypt_update,
)
from hapticnet.protocol.seal import EPOCH_BITS, TAG_BYTES, Seal

Bytes = npt.NDArray[np.uint8]

REFUSED: Final = -1
"""The datagram does not open, or must not be sealed."""

FOR_SEAL: Final = -2
"""The datagram is not of the row's epoch: the `Seal` must decide."""

OPENS: Final = 0
"""Column: address of the context that opens, 0 if there is none."""

SEALS: Final = 1
"""Column: address of the context that seals, 0 if there is none."""

RECEIVE_EPOCH: Final = 2
SEND_EPOCH: Final = 3

SENT: Final = 4
"""Column: the highest sequence number sealed, -1 before the first."""

NONCE: Final = 5
"""First of two columns: 12 bytes of nonce."""

WRITTEN: Final = 7
"""Column that libcrypto writes lengths to. Nothing reads them: they are known before."""

COLUMNS: Final = 8


def open_body(
    row: IntArray,
    data: Bytes,
    start: int,
    body_start: int,
    body_length: int,
    sequence: int,
    out: Bytes,
    out_start: int,
) -> int:
    """Open the sealed body of a datagram; return the length of what was in it, REFUSED or FOR_SEAL.

    Parameters
    ----------
    row
        The row of the session, shape (COLUMNS,).
    data, start
        Where the datagram begins.
    body_start, body_length
        The byte string that is its last element, without msgpack head.
    sequence
        Its sequence number, 0 ≤ sequence < 2³².
    out, out_start
        Where the fields go. If the body is refused, they are zeros, as long as they would be.
    """
    if row[OPENS] == 0 or sequence >> EPOCH_BITS != row[RECEIVE_EPOCH]:
        return FOR_SEAL
    # As in `Seal.open`: a longer msgpack head than the shortest puts one byte more before it than was sealed.
    head_length = body_start - start - (2 if body_length < 256 else 3)
    length = body_length - TAG_BYTES
    if min(start, head_length, length, out_start) < 0:
        return REFUSED
    if body_start + body_length > len(data) or out_start + length > len(out):
        return REFUSED
    row[NONCE] = sequence << 32  # with the next column four zero bytes and a number of eight; numba is little-endian
    row[NONCE + 1] = 0
    context = int(row[OPENS])
    nonce = row.ctypes.data + 8 * NONCE
    written = row.ctypes.data + 8 * WRITTEN
    given = data.ctypes.data
    opened = out.ctypes.data + out_start
    if (
        decrypt_init(context, 0, 0, 0, nonce) == 1
        and context_ctrl(context, SET_TAG, TAG_BYTES, given + body_start + length) == 1
        and decrypt_update(context, 0, written, given + start, head_length) == 1
        and decrypt_update(context, opened, written, given + body_start, length) == 1
        and decrypt_final(context, opened + length, written) == 1
    ):
        return length
    out[out_start : out_start + length] = 0  # nothing may be read that was not authenticated
    return REFUSED


def seal_body(
    row: IntArray,
    out: Bytes,
    start: int,
    head_end: int,
    body: Bytes,
    body_start: int,
    length: int,
    sequence: int,
) -> int:
    """Seal a body behind the head of its datagram; return where the datagram ends in `out`, REFUSED or FOR_SEAL.

    Parameters
    ----------
    row
        The row of the session, shape (COLUMNS,).
    out, start, head_end
        The datagram, of which everything before the body's msgpack head has been written.
    body, body_start, length
        The message's fields. They do not overlap with `out`, or are exactly where the sealed body will be.
    sequence
        The sequence number in the head. It is REFUSED unless it is above that of every earlier datagram.
    """
    if row[SEALS] == 0 or sequence >> EPOCH_BITS != row[SEND_EPOCH]:
        return FOR_SEAL
    sealed_length = length + TAG_BYTES
    sealed_start = head_end + (2 if sealed_length < 256 else 3)
    end = sealed_start + sealed_length
    if sequence <= row[SENT] or min(start, head_end - start, length, body_start) < 0:
        return REFUSED
    if end > len(out) or body_start + length > len(body) or sealed_length >= 65536:
        return REFUSED
    row[SENT] = sequence  # used up, whatever happens next
    row[NONCE] = sequence << 32
    row[NONCE + 1] = 0
    context = int(row[SEALS])
    nonce = row.ctypes.data + 8 * NONCE
    written = row.ctypes.data + 8 * WRITTEN
    given = out.ctypes.data
    sealed = given + sealed_start
    if (
        encrypt_init(context, 0, 0, 0, nonce) != 1
        or encrypt_update(context, 0, written, given + start, head_end - start) != 1
        or encrypt_update(context, sealed, written, body.ctypes.data + body_start, length) != 1
        or encrypt_final(context, sealed + length, written) != 1
        or context_ctrl(context, GET_TAG, TAG_BYTES, sealed + length) != 1
    ):
        return REFUSED
    if sealed_length < 256:
        out[head_end] = 0xC4  # bin 8
        out[head_end + 1] = sealed_length
    else:
        out[head_end] = 0xC5  # bin 16
        out[head_end + 1] = sealed_length >> 8
        out[head_end + 2] = sealed_length & 255
    return end


def tell(seal: Seal, row: IntArray) -> None:
    """Tell a `Seal` what its row has sealed, so that it does not use these sequence numbers again."""
    seal.note_sealed(int(row[SENT]))


class RowSeal:
    """The contexts of a session whose datagrams are sealed and opened by compiled functions.

    Keep it as long as its row is in use.

    Parameters
    ----------
    seal, row
        As for `load`.

    Raises
    ------
    UnavailableError
        If `libcrypto.version` is None.
    """

    def __init__(self, seal: Seal, row: IntArray) -> None:
        self._receive_key, self._send_key = seal.receive_key, seal.send_key
        self._opens = Context(self._receive_key, seals=False)
        self._seals = Context(self._send_key, seals=True)
        row[:] = 0
        self.load(seal, row)

    def load(self, seal: Seal, row: IntArray) -> None:
        """Write the present state of a `Seal` into its row, shape (COLUMNS,), and tell it what the row has sealed."""
        if row[SEALS] == self._seals.address and row[SENT] > seal.sent:
            tell(seal, row)
        if self._receive_key != seal.receive_key:
            self._opens.set_key(seal.receive_key)
            self._receive_key = seal.receive_key
        if self._send_key != seal.send_key:
            self._seals.set_key(seal.send_key)
            self._send_key = seal.send_key
        row[:] = 0
        row[OPENS], row[SEALS] = self._opens.address, self._seals.address
        row[RECEIVE_EPOCH], row[SEND_EPOCH], row[SENT] = seal.receive_epoch, seal.send_epoch, seal.sent

    def release(self, row: IntArray) -> None:
        """Clear the row and free the contexts; a second call does nothing more."""
        row[:] = 0
        self._opens.free()
        self._seals.free()
