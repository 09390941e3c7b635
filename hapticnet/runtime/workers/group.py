"""One address for several processes: sockets whose datagrams the kernel distributes by session number (Linux)."""

import ctypes
import errno
import os
import socket
import struct
from typing import Final

from hapticnet.errors import UnavailableError
from hapticnet.runtime.udp import HostPort, bound_address, listen

MOST_WORKERS: Final = 64

SO_ATTACH_REUSEPORT_CBPF: Final = 51
"""Option of a socket: the program that chooses among those of its group (<asm-generic/socket.h>, socket(7))."""

SESSION_AT: Final = 3
"""Where a datagram's session number begins: after the heads of array, version and kind."""

UINT32: Final = 0xCE
"""What precedes a number from 2^16 on in msgpack; then come four bytes, the highest first."""

ANYONE: Final = 0xFFFFFFFF
"""No socket has this number, so the kernel chooses by the hash of both addresses."""

# Classic BPF (<linux/bpf_common.h>): load length, byte or word, jump if equal or at least, modulo, return.
_LOAD_LENGTH, _LOAD_BYTE, _LOAD_WORD, _JUMP_EQUAL, _JUMP_LEAST = 0x80, 0x30, 0x20, 0x15, 0x35
_MODULO, _RETURN, _RETURN_A = 0x94, 0x06, 0x16


def open_group(address: HostPort, count: int) -> list[socket.socket]:
    """Return `count` sockets bound to one address; a datagram of session n arrives at number n modulo `count`.

    Datagrams of no session arrive at any. Keep all sockets open: the numbers of the others would change.

    Raises
    ------
    UnavailableError
        If the address is not available, or this system cannot distribute datagrams in this way.
    """
    probe = listen(address)  # without SO_REUSEPORT, so it fails if another slave has this port
    bound = HostPort(address.host, bound_address(probe).port)
    probe.close()
    sockets: list[socket.socket] = []
    try:
        for _ in range(count):
            sockets.append(listen(bound, shared=True))
        steer(sockets[0], count)
    except BaseException:
        for sock in sockets:
            sock.close()
        raise
    return sockets


def steer(sock: socket.socket, count: int) -> None:
    """Let the kernel distribute the datagrams of a socket's group by session number."""
    program = [
        (_LOAD_LENGTH, 0, 0, 0),
        (_JUMP_LEAST, 0, 5, SESSION_AT + 5),  # to load what is not there would choose number 0
        (_LOAD_BYTE, 0, 0, SESSION_AT),
        (_JUMP_EQUAL, 0, 3, UINT32),
        (_LOAD_WORD, 0, 0, SESSION_AT + 1),
        (_MODULO, 0, 0, count),
        (_RETURN_A, 0, 0, 0),
        (_RETURN, 0, 0, ANYONE),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *each) for each in program))
    try:
        sock.setsockopt(
            socket.SOL_SOCKET, SO_ATTACH_REUSEPORT_CBPF, struct.pack("@HP", len(program), ctypes.addressof(code))
        )
    except OSError as error:
        name = errno.errorcode.get(error.errno or 0, "?")
        raise UnavailableError(
            f"this system cannot distribute datagrams over workers ({name}: {os.strerror(error.errno or 0)}); Linux"
            " 4.5 or later can; use --workers 1"
        ) from error


def discard_waiting(sock: socket.socket) -> int:
    """Throw away what waits at a socket; return how many datagrams that were."""
    count = 0
    while True:
        try:
            sock.recv(1)
        except BlockingIOError:
            return count
        except OSError:  # an error of an earlier datagram
            continue
        count += 1
