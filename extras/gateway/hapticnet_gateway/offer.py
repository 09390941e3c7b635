"""What a gateway takes from a tab's offer: seven checked values. Nothing else of it has any effect.

An offer is a description of a WebRTC connection in SDP (RFC 8866, RFC 8841). Candidates in it are not read: a gateway
that sent checks to them would send datagrams to any address that somebody writes there. The tab's address becomes known
when its own checks arrive; only a reader of the gateway's answer can send them.
"""

import re
from dataclasses import dataclass
from typing import Final

from hapticnet.errors import PeerError

LARGEST_OFFER: Final = 16 * 1024  # bytes; that of a browser with candidates of a dozen interfaces has 3 kB
MOST_LINES: Final = 256

_ICE: Final = "[A-Za-z0-9+/]"
_ATTRIBUTES: Final = {
    "ice-ufrag": re.compile(f"{_ICE}{{4,256}}"),
    "ice-pwd": re.compile(f"{_ICE}{{22,256}}"),
    "fingerprint": re.compile("sha-256 (?:[0-9A-Fa-f]{2}:){31}[0-9A-Fa-f]{2}"),
    "setup": re.compile("actpass|active"),
    "mid": re.compile("[A-Za-z0-9]{1,16}"),
    "sctp-port": re.compile("[1-9][0-9]{0,4}"),
}
_MEDIA: Final = re.compile(r"m=application [0-9]{1,5} UDP/DTLS/SCTP webrtc-datachannel")
_CLEAN: Final = """v=0
o=- 1 1 IN IP4 127.0.0.1
s=-
t=0 0
a=group:BUNDLE {mid}
m=application 9 UDP/DTLS/SCTP webrtc-datachannel
c=IN IP4 0.0.0.0
a=ice-ufrag:{ice-ufrag}
a=ice-pwd:{ice-pwd}
a=fingerprint:{fingerprint}
a=setup:{setup}
a=mid:{mid}
a=sctp-port:{sctp-port}
a=max-message-size:{size}
"""


@dataclass(frozen=True, slots=True)
class Offer:
    """A tab's offer, reduced to what is checked."""

    values: dict[str, str]  # by the attribute's name

    def clean(self, largest_bytes: int) -> str:
        """Return an offer with these values alone, whose messages have at most `largest_bytes`."""
        return _CLEAN.format_map({**self.values, "size": largest_bytes}).replace("\n", "\r\n")


def read_offer(data: bytes) -> Offer:
    """Return what an offer says; raise PeerError unless it asks for data channels and nothing else."""
    if len(data) > LARGEST_OFFER:
        raise PeerError(f"the offer has {len(data)} bytes; at most {LARGEST_OFFER} are read")
    try:
        lines = data.decode("ascii").splitlines()
    except UnicodeDecodeError:
        raise PeerError("the offer is not ASCII text") from None
    if len(lines) > MOST_LINES:
        raise PeerError(f"the offer has {len(lines)} lines; at most {MOST_LINES} are read")
    media = [line for line in lines if line.startswith("m=")]
    if len(media) != 1 or _MEDIA.fullmatch(media[0]) is None:
        raise PeerError("the offer must have one m= line, for a data channel over UDP/DTLS/SCTP")
    values: dict[str, str] = {}
    for line in lines:
        name, _, value = line.removeprefix("a=").partition(":")
        if not line.startswith("a=") or name not in _ATTRIBUTES:
            continue
        if name == "fingerprint" and not value.startswith("sha-256 "):  # some send one for each hash
            continue
        if _ATTRIBUTES[name].fullmatch(value) is None:
            raise PeerError(f"the offer's {name} is not valid")
        if values.setdefault(name, value) != value:
            raise PeerError(f"the offer has two values of {name}")
    for name in _ATTRIBUTES:
        if name not in values:
            raise PeerError(f"the offer has no {name}")
    if int(values["sctp-port"]) > 65535:
        raise PeerError("the offer's sctp-port is not valid")
    return Offer(values)
