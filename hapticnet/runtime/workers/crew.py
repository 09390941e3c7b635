"""The workers of a slave: started, followed, started again if they end, and ended together."""

import asyncio
import os
import secrets
import signal
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final

from hapticnet.errors import FileError, HapticnetError, RefusedError, SettingsError, UnavailableError
from hapticnet.runtime.workers.exchange import mailboxes
from hapticnet.runtime.workers.group import discard_waiting
from hapticnet.runtime.workers.link import Say
from hapticnet.runtime.workers.process import WorkerProcess
from hapticnet.runtime.workers.table import Table, shared_file

QUICK_S: Final = 5.0
"""A worker that ends so soon [s] after its start has a fault that may come again."""

MOST_QUICK_ENDS: Final = 5
"""After so many quick ends in a row the slave ends."""

FIRST_PAUSE_S: Final = 0.1
"""Time [s] before a worker is started again; doubles with each quick end."""

PARTING_S: Final = 10.0
"""Time [s] that workers may take to end their sessions, recordings and scenes."""

SILENT_S: Final = 3.0
"""Time [s] without news after which a worker counts as stuck."""

KILL_AFTER_S: Final = 10.0
"""Time [s] without news after which a worker is killed, and started again."""

LOOK_S: Final = 0.5

CLEAN_END_S: Final = 0.5
"""Time [s] between the clean end of a worker and the parent's own: a service manager sends SIGTERM to all processes."""

ERRORS: Final[Mapping[int, type[HapticnetError]]] = {
    error.exit_code: error for error in (SettingsError, FileError, UnavailableError, RefusedError)
}


class Worker:
    """One worker: its present process, and figures of earlier ones.

    Attributes
    ----------
    ended
        Of each process that has ended: how, and its newest figures.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.process: WorkerProcess | None = None
        self.ended: list[tuple[str, dict[str, Any]]] = []

    @property
    def ready(self) -> dict[str, Any] | None:
        """What it said when it began to serve; None while it does not."""
        return self.process.ready if self.process is not None else None

    @property
    def news(self) -> dict[str, Any]:
        """Its newest figures; empty if there are none."""
        return (self.process.news if self.process is not None else None) or {}


class Supervisor:
    """Keep the workers of a slave running.

    Parameters
    ----------
    module
        What a worker runs. Its arguments are descriptors: the line to the parent, its socket, the table, its inbox,
        and the others' outboxes.
    sockets
        The group of sockets, one for each worker. They stay open here, so a worker that is started again gets its own.
    seats
        Most sessions of all together.
    set_up
        What each worker is told in addition, as JSON.
    on_line
        Called with each line of a worker.
    tell
        Called with a line for the user when a worker has ended.
    """

    def __init__(
        self,
        module: str,
        sockets: list[socket.socket],
        seats: int,
        set_up: Mapping[str, Any],
        on_line: Callable[[str], None],
        tell: Callable[[str], None],
    ) -> None:
        count = len(sockets)
        self.workers = [Worker(number) for number in range(count)]
        self._module = module
        self._sockets = sockets
        self._on_line = on_line
        self._tell = tell
        secret = secrets.token_bytes(32)
        self._set_up = {**set_up, "workers": count, "secret": secret.hex()}
        self._file = shared_file(count, seats)
        self._table = Table(self._file, count, seats, secret)
        self._inboxes, self._outboxes = mailboxes(count)
        self._stopping = asyncio.Event()
        self._changed = asyncio.Event()
        self._failure: HapticnetError | None = None
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self) -> None:
        """Start all workers and wait until each serves.

        Raises
        ------
        HapticnetError
            If one cannot begin. The others are ended then.
        """
        self._tasks = [asyncio.create_task(self._try_to_keep(worker)) for worker in self.workers]
        while self._failure is None and not all(worker.ready for worker in self.workers):
            await self._change()
        if self._failure is not None:
            await self.stop()
            raise self._failure

    async def until_failure(self) -> None:
        """Wait until a worker ends again and again, and raise why as an UnavailableError; kill those that are stuck."""
        while self._failure is None:
            for worker in self.stuck(KILL_AFTER_S):
                if worker.process is not None:
                    self._tell(f"worker {worker.number} has been stuck for {KILL_AFTER_S:g} s and is killed")
                    worker.process.kill()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._change(), LOOK_S)
        raise self._failure

    def read_again(self) -> None:
        """Let all workers read the list of masters again."""
        for worker in self.workers:
            if worker.process is not None:
                worker.process.say(Say.READ_AGAIN)

    def stuck(self, silent_s: float = SILENT_S) -> list[Worker]:
        """Return the workers that serve and have not said anything for so long."""
        now_s = asyncio.get_running_loop().time()
        return [
            worker
            for worker in self.workers
            if worker.process is not None and worker.process.ready and now_s - worker.process.heard_s > silent_s
        ]

    async def stop(self) -> None:
        """End all workers, and wait for their reports."""
        self._stopping.set()
        for worker in self.workers:
            if worker.process is not None:
                worker.process.say(Say.STOP)
        if self._tasks:
            _, late = await asyncio.wait(self._tasks, timeout=PARTING_S)
            for worker, task in zip(self.workers, self._tasks, strict=True):
                if task in late and worker.process is not None:
                    self._tell(f"worker {worker.number} did not end within {PARTING_S:g} s and was killed")
                    worker.process.kill()
            await asyncio.gather(*self._tasks)
        for sock in (*self._sockets, *self._inboxes, *self._outboxes):
            sock.close()
        os.close(self._file)

    async def _change(self) -> None:
        await self._changed.wait()
        self._changed.clear()

    async def _try_to_keep(self, worker: Worker) -> None:
        try:
            await self._keep(worker)
        except OSError as error:  # no process, or no descriptor, is left
            self._failure = UnavailableError(f"worker {worker.number} cannot be started: {error.strerror or error}")
            self._changed.set()

    async def _keep(self, worker: Worker) -> None:
        """Run a worker again and again until the slave ends."""
        loop = asyncio.get_running_loop()
        quick = 0
        mail = self._inboxes[worker.number]
        own = self._sockets[worker.number].fileno(), self._file, mail.fileno()
        while not self._stopping.is_set():
            worker.process = WorkerProcess(
                self._module, [*own, *(box.fileno() for box in self._outboxes)], self._on_line
            )
            began_s = loop.time()
            code = await worker.process.run(self._set_up | {"worker": worker.number}, self._changed.set)
            lost = self._table.sessions_of(worker.number)
            self._table.clear(worker.number)
            if await self._stops_within(CLEAN_END_S if code == 0 else 0.0):
                return
            quick = quick + 1 if loop.time() - began_s < QUICK_S else 1
            if not self._goes_on(worker, worker.process, how(code), lost, quick):
                self._changed.set()
                return
            worker.ended.append((how(code), worker.news | {"masters": lost}))
            worker.process = None
            if not await self._stops_within(FIRST_PAUSE_S * 2 ** (quick - 1)):
                # What arrived in between is stale, and masters ask again.
                discard_waiting(self._sockets[worker.number])
                discard_waiting(mail)

    async def _stops_within(self, seconds: float) -> bool:
        """Wait for so long; return whether the slave ends, as soon as it does."""
        if seconds:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), seconds)
        return self._stopping.is_set()

    def _goes_on(self, worker: Worker, process: WorkerProcess, end: str, lost: int, quick: int) -> bool:
        """Return whether a worker that has ended is to be started again."""
        if process.failure is not None and not worker.ended:  # it has never served: an option is wrong
            error = ERRORS.get(process.failure["exit_code"], HapticnetError)
            self._failure = error(process.failure["message"])
        elif quick >= MOST_QUICK_ENDS:
            reason = process.failure["message"] if process.failure is not None else end
            self._failure = UnavailableError(
                f"worker {worker.number} ended {quick} times within {QUICK_S:g} s of its start; the last time: {reason}"
            )
        else:
            sessions = f"{lost} session{'s' * (lost != 1)}"
            self._tell(f"worker {worker.number} ended ({end}) with {sessions}; it is started again")
        return self._failure is None


def how(code: int) -> str:
    """Return in words how a process has ended."""
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name
