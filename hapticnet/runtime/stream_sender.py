"""The process of ``--stream``: it reads samples from its standard input and sends each as a JSON datagram."""

import json
import math
import signal
import socket
import sys
from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Final

from hapticnet.runtime.frames import read_frames

DIGITS: Final = 9
"""Digits after the decimal point; the range is checked elsewhere: metres and newtons."""


def messages(definition: Mapping[str, Any], rows: "array[float]") -> Iterator[bytes]:
    """Yield the samples of a series as JSON for PlotJuggler.

    Parameters
    ----------
    definition
        Path and columns of the series, and what to add to its time [s] for Unix time.
    rows
        Its samples, t_us first, as one flat array.
    """
    columns, offset_s = definition["columns"], definition["offset_s"]
    width = 1 + len(columns)
    for start in range(0, len(rows), width):
        t_us, *values = rows[start : start + width]
        # JSON has no infinity, and PlotJuggler stops at what is not JSON.
        inner: Any = {
            name: round(value, DIGITS) for name, value in zip(columns, values, strict=True) if math.isfinite(value)
        }
        for name in reversed(definition["path"]):
            inner = {name: inner}
        yield json.dumps({"timestamp": round(t_us / 1e6 + offset_s, 6), **inner}).encode()


def main() -> None:
    """Send until the standard input is closed; datagrams that cannot be sent are lost, as UDP's are."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a service manager sends it to all processes; the node ends this one
    descriptor, host, port = sys.argv[1:]
    target = host, int(port)
    series: dict[int, dict[str, Any]] = {}
    with socket.socket(fileno=int(descriptor)) as sock:
        sock.setblocking(True)
        for kind, body in read_frames(sys.stdin.buffer):
            if kind == 0:
                definition = json.loads(body)
                series[definition["series"]] = definition
                continue
            rows = array("d", body)
            for message in messages(series[int(rows[0])], rows[1:]):
                with suppress(OSError):
                    sock.sendto(message, target)


if __name__ == "__main__":
    main()
