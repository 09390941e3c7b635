import pytest

from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.runtime.udp import bound_address, listen, parse_host_port


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("127.0.0.1:47800", "127.0.0.1", 47800), ("[::1]:1", "::1", 1), ("slave.lab:65535", "slave.lab", 65535)],
)
def test_addresses_are_read_and_written_alike(text, host, port):
    address = parse_host_port(text)
    assert (address.host, address.port) == (host, port)
    assert str(address) == text


@pytest.mark.parametrize(
    "text", ["", "host", ":1", "host:", "host:0", "host:65536", "host:-1", "host:1.5", "::1:5", "h:١"]
)
def test_invalid_addresses_are_refused(text):
    with pytest.raises(SettingsError):
        parse_host_port(text)


def test_a_port_in_use_is_reported():
    with listen(parse_host_port("127.0.0.1:0", lowest_port=0)) as first:
        address = bound_address(first)
        with pytest.raises(UnavailableError, match=f"cannot listen on {address}: the port is in use"):
            listen(address)
