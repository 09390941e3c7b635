"""The connection to Haply's local service: ``--operator haply``."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from aiohttp import ClientError, ClientSession, ClientWebSocketResponse, ClientWSTimeout, WSMsgType

from hapticnet.node.events import NodeEvent
from hapticnet.operator.haply import HaplyOperator
from hapticnet.runtime.system import now_us
from hapticnet.runtime.watching import Watcher

CONNECT_S: Final = 2.0
SILENT_S: Final = 0.1  # time [s] without an answer after which the force is zero
PATIENCE: Final = 10  # silent times after which the connection is opened again
AGAIN_S: Final = 1.0  # time [s] between two attempts to connect
CLOSE_S: Final = 0.2  # longest time [s] that the last message, and then the closing, may take


class HaplyPort(Watcher[NodeEvent]):
    """Pass messages between the service and a `HaplyOperator`; `say` and `warn` print messages for a person.

    The service answers each message with one state. So a command leaves after each tick, but only one at a time: a slow
    service delays no tick and gathers no queue of old forces.
    """

    name = "haply operator"

    def __init__(
        self, hand: HaplyOperator, address: str, say: Callable[[str], None], warn: Callable[[str], None]
    ) -> None:
        self._hand, self._address, self._say, self._warn = hand, address, say, warn
        self._due = asyncio.Event()
        self._ending = False

    async def start(self) -> None:
        """Begin to connect."""
        self._task = asyncio.create_task(self._run())

    def observe(self, now_us: int) -> None:
        """Let the next command leave."""
        self._hand.observe(now_us)
        self._due.set()
        while (message := self._hand.next_message()) is not None:
            (self._warn if message[1] else self._say)(message[0])

    async def stop(self) -> None:
        """Set the force to zero, and close the connection once the service has answered."""
        self._hand.feel(0, (0.0,) * self._hand.axes)
        self._ending = True
        self._due.set()
        await asyncio.wait({self._task}, timeout=CLOSE_S)
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task

    async def _run(self) -> None:
        url = f"ws://{self._address}"
        async with ClientSession() as session:
            while True:
                try:
                    async with asyncio.timeout(CONNECT_S):
                        opened = await session.ws_connect(url, timeout=ClientWSTimeout(ws_close=CLOSE_S))
                    async with opened:
                        await self._talk(opened)
                except (OSError, ClientError):  # a timeout is an OSError
                    self._hand.fail(f"no Haply service at {self._address}", now_us(), lost=True)
                if self._ending:
                    return
                await asyncio.sleep(AGAIN_S)

    async def _talk(self, to: ClientWebSocketResponse) -> None:
        """Exchange messages until there is no such device; OSError if the service closes, or is silent for long."""
        owed, silent, last = 1, 0, False
        while True:
            while owed:
                try:
                    message = await to.receive(SILENT_S)
                except TimeoutError:
                    silent += 1
                    self._hand.fail(f"the Haply service is silent for {1e3 * SILENT_S:g} ms", now_us())
                    if silent == PATIENCE:
                        raise
                    if silent == 1 and self._hand.device_id is not None:
                        await to.send_str(self._hand.command(now_us()))
                        owed += 1
                    continue
                if message.type not in (WSMsgType.TEXT, WSMsgType.BINARY):
                    raise ConnectionResetError
                owed, silent = owed - 1, 0
                self._hand.receive(message.data, now_us())
                if self._hand.device_id is None:
                    return
            if last:
                return
            if not self._ending:  # otherwise no tick follows
                self._due.clear()
                await self._due.wait()
            last = self._ending
            await to.send_str(self._hand.command(now_us()))
            owed = 1
