"""The sockets of scenes in other programs: ``--scene udp:[HOST:]PORT``."""

import socket
from contextlib import suppress
from pathlib import Path

from hapticnet.plain_datagrams import is_program
from hapticnet.runtime.hand_port import BUFFER_BYTES, MOST_IN_A_PERIOD
from hapticnet.runtime.system import now_us
from hapticnet.runtime.udp import READ_BYTES, HostPort, is_loopback, open_toward, parse_host_port
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.remote import RemoteScene, RemoteSettings, parse_remote
from hapticnet.scene.sources import SceneSource, UserSource, find_source
from hapticnet.user_code import UserClass


class UdpScene:
    """A `RemoteScene` with its socket, which only the program's own datagrams pass. A step never waits."""

    def __init__(self, settings: RemoteSettings, sock: socket.socket, name: str) -> None:
        self.remote = RemoteScene(settings, name.partition(":")[2])
        self.axes, self.name = settings.axes, name
        self.next_line, self.report, self.close = self.remote.next_line, self.remote.report, sock.close
        self._sock = sock
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)

    def step(self, sample: PositionSample) -> ForceSample:
        """Read the answers that have arrived, ask about this position, and return the newest force."""
        now = now_us()
        for _ in range(MOST_IN_A_PERIOD):  # the system drops the rest of a flood
            try:
                self.remote.receive(self._sock.recv(READ_BYTES), now)
            except BlockingIOError:
                break
            except OSError:  # an earlier question could not be delivered: the program does not run
                continue
        with suppress(OSError):  # the question counts as lost
            self._sock.send(self.remote.ask(sample, now))
        return ForceSample(sample.t_us, self.remote.force_n(now))


def find_live_source(spec: str, folder: Path = Path()) -> SceneSource:
    """Return the source of scenes written as `spec`, also of those in other programs; see `find_source`.

    Raise UnavailableError if there is no such host.
    """
    if not is_program(spec):
        return find_source(spec, folder)
    place, settings = parse_remote(spec)
    sock, target = open_toward(parse_host_port(place))
    sock.close()
    address = HostPort(*target[:2])  # found once, because finding a host may take seconds

    def make() -> UdpScene:
        sock, target = open_toward(address)
        sock.connect(target)
        return UdpScene(settings, sock, f"udp:{address}"[:64])

    source = UserSource(UserClass("scene", f"udp:{address}", make))
    if not is_loopback(target):
        risk = f"whoever answers at {address} decides the force; datagrams there are neither encrypted nor checked"
        source.risks = (risk,)
    return source
