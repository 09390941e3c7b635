"""QUIC datagrams (RFC 9221) of aioquic; they are neither repeated nor kept in order."""

import asyncio
import datetime
import ssl
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aioquic.asyncio import QuicConnectionProtocol
from aioquic.asyncio import connect as quic_connect
from aioquic.asyncio import serve as quic_serve
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import DatagramFrameReceived, QuicEvent
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from stacks import PORT, Answer, Deliver, Ready, Send


class Datagrams(QuicConnectionProtocol):
    """Pass each datagram on, and send datagrams at once."""

    def __init__(self, *arguments: Any, take: Callable[["Datagrams", bytes], None], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._take = take

    def quic_event_received(self, event: QuicEvent) -> None:
        if isinstance(event, DatagramFrameReceived):
            self._take(self, event.data)

    def send(self, data: bytes) -> None:
        self._quic.send_datagram_frame(data)
        self.transmit()


def configuration(*, is_client: bool) -> QuicConfiguration:
    return QuicConfiguration(
        is_client=is_client, alpn_protocols=["touch"], max_datagram_frame_size=1200, verify_mode=ssl.CERT_NONE
    )


def certify(folder: Path) -> tuple[Path, Path]:
    """Write a certificate and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "bench")])
    now = datetime.datetime.now(datetime.UTC)
    made = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
    made = made.not_valid_before(now - datetime.timedelta(days=1)).not_valid_after(now + datetime.timedelta(days=1))
    certificate, private = folder / "certificate.pem", folder / "key.pem"
    certificate.write_bytes(made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    private.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return certificate, private


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    settings = configuration(is_client=False)
    with tempfile.TemporaryDirectory() as folder:
        settings.load_cert_chain(*certify(Path(folder)))

    def take(protocol: Datagrams, data: bytes) -> None:
        protocol.send(answer(data))

    await quic_serve(host, PORT, configuration=settings, create_protocol=lambda *a, **k: Datagrams(*a, take=take, **k))
    ready()
    await asyncio.Event().wait()


async def connect(host: str, deliver: Deliver) -> Send:
    def make(*arguments: Any, **options: Any) -> Datagrams:
        return Datagrams(*arguments, take=lambda _, data: deliver(data), **options)

    connection = quic_connect(host, PORT, configuration=configuration(is_client=True), create_protocol=make)
    protocol = await connection.__aenter__()

    def send(data: bytes, _kept: object = connection) -> None:  # which closes the connection when it is collected
        protocol.send(data)  # type: ignore[attr-defined]

    return send
