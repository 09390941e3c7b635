"""A gateway takes seven checked values from an offer, and nothing else."""

import re

import pytest
from aiortc import sdp
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import PeerError
from hapticnet.web.offer import LARGEST_OFFER, read_offer

FINGERPRINT = ":".join(f"{each:02X}" for each in range(32))
OFFER = f"""v=0
o=- 4567 2 IN IP4 127.0.0.1
s=-
t=0 0
a=group:BUNDLE 0
a=extmap-allow-mixed
a=msid-semantic: WMS
m=application 51234 UDP/DTLS/SCTP webrtc-datachannel
c=IN IP4 198.51.100.7
a=candidate:1 1 udp 2113937151 0f1e.local 51234 typ host generation 0
a=candidate:2 1 udp 1677729535 198.51.100.7 9 typ srflx raddr 10.0.0.1 rport 22
a=ice-ufrag:Ab+/
a=ice-pwd:0123456789012345678901
a=ice-options:trickle
a=fingerprint:sha-256 {FINGERPRINT}
a=setup:actpass
a=mid:0
a=sctp-port:5000
a=max-message-size:262144
a=end-of-candidates
""".replace("\n", "\r\n")


def test_addresses_in_an_offer_are_not_taken():
    clean = read_offer(OFFER.encode()).clean(1200)
    assert not re.search("candidate|198|local", clean)
    media = sdp.SessionDescription.parse(clean).media[0]
    assert (media.ice.usernameFragment, media.dtls.fingerprints[0].value) == ("Ab+/", FINGERPRINT)
    assert media.ice_candidates == []
    assert media.sctpCapabilities.maxMessageSize == 1200


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("m=application 51234 UDP/DTLS/SCTP", "m=audio 9 UDP/TLS/RTP/SAVPF"), "one m= line"),
        (("a=mid:0", "m=application 9 UDP/DTLS/SCTP webrtc-datachannel\r\na=mid:0"), "one m= line"),
        (("a=mid:0", "a=mid:0\r\na=mid:1"), "two values of mid"),
        (("a=ice-pwd:0123456789012345678901\r\n", ""), "no ice-pwd"),
        (("0123456789012345678901", "short"), "ice-pwd is not valid"),
        (("sha-256", "sha-1"), "no fingerprint"),
        (("00:01", "00"), "fingerprint is not valid"),
        (("setup:actpass", "setup:passive"), "setup is not valid"),
        (("sctp-port:5000", "sctp-port:65536"), "sctp-port is not valid"),
        (("v=0", "v=0\r\n" * 300), "lines; at most"),
        (("v=0", "v=" + "0" * LARGEST_OFFER), "bytes; at most"),
        (("v=0", "v=\u00b2"), "not ASCII"),
    ],
    ids=lambda each: each[1][:20] if isinstance(each, tuple) else each,
)
def test_an_offer_of_anything_else_is_refused_in_words(change, why):
    with pytest.raises(PeerError, match=why):
        read_offer(OFFER.replace(*change).encode())


@given(
    st.binary(max_size=2000) | st.lists(st.sampled_from(OFFER.splitlines()), max_size=40).map("\n".join).map(str.encode)
)
def test_garbage_is_refused_or_a_clean_offer(data):
    try:
        clean = read_offer(data).clean(1200)
    except PeerError:
        return
    assert len(sdp.SessionDescription.parse(clean).media) == 1
