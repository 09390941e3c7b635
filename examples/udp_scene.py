"""A scene in the program below: ``slave --scene examples/udp_scene.py:Remote``, beside ``python3 udp_scene.py``."""

import contextlib
import json
import socket
import sys
import time

import hapticnet as hn


class Remote:
    """Sends each position and returns the newest force; 20 ms without an answer, and it decays within 20 ms."""

    def __init__(self, host: str = "127.0.0.1", port: int = 47901, axes: int = 1) -> None:
        self.axes, self.force_n, self.asked_s, self.share = axes, [0.0] * axes, 0.0, 1.0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, port))
        self.close = self.socket.close

    def step(self, sample: hn.PositionSample) -> list[float]:
        """Return a force without waiting."""
        self.asked_s = self.asked_s or time.monotonic()
        with contextlib.suppress(OSError):  # no more answers, or nobody there
            self.socket.send(json.dumps({"position_m": sample.position_m, "t_us": sample.t_us}).encode())
            while answer := self.socket.recv(512, socket.MSG_DONTWAIT):
                self.force_n, self.asked_s = json.loads(answer)["force_n"], 0.0
        before, late_s = self.share, time.monotonic() - self.asked_s if self.asked_s else 0.0
        self.share = min(max(2.0 - late_s / 0.02, 0.0), 1.0)
        if self.share < before == 1.0:
            print("the scene does not answer: the force decays", file=sys.stderr)
        return [self.share * each for each in self.force_n]


if __name__ == "__main__":
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wall:
        wall.bind(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 47901))
        while asked := wall.recvfrom(512):
            depth_m = json.loads(asked[0])["position_m"][0]
            wall.sendto(json.dumps({"force_n": [max(0.0, 400.0 * (depth_m - 0.010))]}).encode(), asked[1])
