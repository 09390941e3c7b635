"""A WebRTC data channel of aiortc: unordered, without retransmissions. The offer and its answer travel over TCP."""

import asyncio
import json

from aiortc import RTCConfiguration, RTCDataChannel, RTCPeerConnection, RTCSessionDescription

from stacks import PORT, Answer, Deliver, Ready, Send


def description(connection: RTCPeerConnection) -> bytes:
    local = connection.localDescription
    return json.dumps({"sdp": local.sdp, "type": local.type}).encode() + b"\n"


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    connection = RTCPeerConnection(RTCConfiguration(iceServers=[]))

    @connection.on("datachannel")
    def opened(channel: RTCDataChannel) -> None:
        channel.on("message", lambda data: channel.send(answer(data)))

    async def signal(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await connection.setRemoteDescription(RTCSessionDescription(**json.loads(await reader.readline())))
        await connection.setLocalDescription(await connection.createAnswer())
        writer.write(description(connection))

    server = await asyncio.start_server(signal, host, PORT)
    ready()
    await server.serve_forever()


async def connect(host: str, deliver: Deliver) -> Send:
    connection = RTCPeerConnection(RTCConfiguration(iceServers=[]))
    channel = connection.createDataChannel("touch", ordered=False, maxRetransmits=0)
    opened = asyncio.Event()
    channel.on("open", opened.set)
    channel.on("message", deliver)
    await connection.setLocalDescription(await connection.createOffer())
    reader, writer = await asyncio.open_connection(host, PORT)
    writer.write(description(connection))
    await connection.setRemoteDescription(RTCSessionDescription(**json.loads(await reader.readline())))
    writer.close()
    await opened.wait()
    send: Send = channel.send
    return send
