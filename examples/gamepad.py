"""A gamepad as the hand, read as Linux offers it: push the left stick forward to push the needle in.

hapticnet master --operator examples/gamepad.py:Gamepad:device=/dev/input/js0
"""

import os
import struct

EVENT = struct.Struct("=IhBB")  # linux/joystick.h: time [ms], value, type, number
AXIS, INITIAL = 0x02, 0x80
FORWARD = 1  # the left stick's second axis; forward is negative


class Gamepad:
    """The stick sets the speed of the tool, so that the tool moves smoothly although events are coarse."""

    def __init__(self, device: str = "/dev/input/js0", fastest_m_per_s: float = 0.06, deepest_m: float = 0.08) -> None:
        self.file = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        self.fastest_m_per_s, self.deepest_m = fastest_m_per_s, deepest_m
        self.stick, self.position_m, self.t_us = 0.0, 0.0, 0

    def sample(self, t_us: int) -> float:
        """Return the position [m] of the tool."""
        try:
            while len(data := os.read(self.file, EVENT.size)) == EVENT.size:
                _, value, kind, number = EVENT.unpack(data)
                if kind & ~INITIAL == AXIS and number == FORWARD:
                    self.stick = -value / 32767
        except BlockingIOError:  # no more events for now
            pass
        elapsed_us, self.t_us = min(t_us - self.t_us, 20_000), t_us
        self.position_m += self.fastest_m_per_s * self.stick * elapsed_us * 1e-6
        self.position_m = min(max(self.position_m, 0.0), self.deepest_m)
        return self.position_m

    def close(self) -> None:
        """Close the device."""
        os.close(self.file)
