"""Move the tool from another program by UDP and JSON, with nothing but the standard library.

    hapticnet master --operator udp:47900
    python3 examples/udp_client.py

docs/use/embedding.md describes the datagrams; any language that has sockets can send them.
"""

import json
import math
import socket
import sys
import time


def main(port: int = 47900, seconds: float = 5.0) -> float:
    """Push in and out for some seconds; print each force and return the largest [N]."""
    largest_n, start_s = 0.0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(("127.0.0.1", port))
        client.settimeout(0.5)
        while (elapsed_s := time.monotonic() - start_s) < seconds:
            position_m = 0.015 * (1.0 - math.cos(2.0 * math.pi * elapsed_s / seconds))
            client.send(json.dumps({"position_m": [position_m]}).encode())
            try:
                answer = json.loads(client.recv(1024))
            except (TimeoutError, ConnectionRefusedError):  # the master is not there, or a datagram was lost
                time.sleep(0.1)
                continue
            (force_n,) = answer["force_n"]
            largest_n = max(largest_n, force_n)
            print(f"{position_m * 1e3:6.2f} mm  {force_n:6.2f} N")
            time.sleep(0.002)  # 500 positions a second
    return largest_n


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
