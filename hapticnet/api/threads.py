"""An event loop in a thread, around something that is entered with ``async with``."""

import asyncio
import threading
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager
from typing import TYPE_CHECKING, Any, TypeVar

from hapticnet.errors import UnavailableError
from hapticnet.runtime.system import loop_factory

if TYPE_CHECKING:
    from collections.abc import Coroutine

Result = TypeVar("Result")


class LoopThread:
    """Enter a context on an event loop in a new thread; `leave` leaves it and ends the thread.

    The constructor waits until the context is entered, and raises what entering raises. The thread is a daemon: a
    program that ends without `leave` is not kept alive.
    """

    def __init__(self, context: AbstractAsyncContextManager[Any], name: str) -> None:
        self._entered: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(context,), name=name, daemon=True)
        self._thread.start()
        try:
            self._entered.result()
        except BaseException as error:
            if not self._entered.done():  # Ctrl-C while waiting
                self._cancel()
            self._thread.join()
            raise error

    def wait_for(self, work: "Coroutine[Any, Any, Result]") -> Result:
        """Run a coroutine on the loop, wait for it, and return its result.

        Raises
        ------
        UnavailableError
            If the thread has ended.
        """
        if not self._thread.is_alive():
            work.close()
            raise UnavailableError("this master or slave was left; enter it again")
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def leave(self) -> None:
        """Leave the context and wait for the end of the thread."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._left.set)
        self._thread.join()

    def _cancel(self) -> None:
        self._loop.call_soon_threadsafe(self._task.cancel)

    def _run(self, context: AbstractAsyncContextManager[Any]) -> None:
        try:
            with asyncio.Runner(loop_factory=loop_factory()) as runner:
                self._loop = runner.get_loop()
                runner.run(self._live(context))
        except asyncio.CancelledError:
            pass
        except BaseException as error:
            if self._entered.done():
                raise
            self._entered.set_exception(error)

    async def _live(self, context: AbstractAsyncContextManager[Any]) -> None:
        self._left = asyncio.Event()
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 - for the type checker: this is a task
        self._task = task
        async with context:
            self._entered.set_result(None)
            await self._left.wait()
