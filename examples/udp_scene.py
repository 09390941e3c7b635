"""A scene in a program of your own, in any language: a wall at 10 mm that hapticnet asks by datagrams.

    hapticnet slave --scene udp:47901
    python3 udp_scene.py 47901

examples/udp_scene.c is the same in C.
"""

import json
import socket
import sys


def force_n(position_m: list[float]) -> list[float]:
    """Return the force [N] at a position [m], one value for each axis: replace this by your model."""
    return [max(0.0, 400.0 * (position_m[0] - 0.010)), *[0.0] * (len(position_m) - 1)]


if __name__ == "__main__":
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 47901))
        while True:  # each master has its own sender
            data, sender = sock.recvfrom(512)
            asked = json.loads(data)
            sock.sendto(json.dumps({"force_n": force_n(asked["position_m"]), "t_us": asked["t_us"]}).encode(), sender)
