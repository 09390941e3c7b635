"""A page without a browser, in a thread: keeps every sample, whatever the browser under test does."""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import aiohttp
import numpy as np

from tests.ready import wait_until
from tests.web.rig import Client


class Observer:
    """Watches a run until `close`; `client` has what came."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._socket = f"http://{parts.netloc}/socket{parts.path}?{parts.query}"
        self._origin = f"http://{parts.netloc}"
        self.client: Client | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._run(),))
        self._thread.start()
        self.until(lambda client: bool(client.frames))

    async def _run(self) -> None:
        self._task = asyncio.current_task()
        with contextlib.suppress(asyncio.CancelledError):
            async with (
                aiohttp.ClientSession() as http,
                http.ws_connect(self._socket, headers={"Origin": self._origin}) as socket,
            ):
                self.client = Client(socket)
                await self.client.read()

    def close(self) -> None:
        assert self._task is not None
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join()
        self._loop.close()

    def until(self, condition: Callable[[Client], bool]) -> None:
        """Wait until what came fulfils a condition."""
        wait_until(lambda: self.client is not None and condition(self.client))

    def frame(self) -> dict[str, Any]:
        assert self.client is not None
        return self.client.frames[-1]

    def rows_have_no_gap(self) -> bool:
        assert self.client is not None
        starts = [first for first, _, _ in self.client.blocks]
        ends = [first + block.shape[1] for first, _, block in self.client.blocks]
        return starts[1:] == ends[:-1]

    def longest_pause_s(self) -> float:
        """Return the longest time between two ticks."""
        assert self.client is not None
        return float(np.diff(self.client.columns()["t"]).max())
