"""A command in a terminal of its own: what it shows, and keys for it."""

import os
import pty
import select
import subprocess
import sys
import time

from tests.ready import PYTHONPATH

PATIENCE_S = 40.0
ENTER, ESCAPE, BACKSPACE, INTERRUPT = "\r", "\x1b", "\x7f", "\x03"


class Terminal:
    """Use it as a context manager."""

    def __init__(self, *arguments, cwd):
        self.shown = ""  # since the last `expect`
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hapticnet", *map(str, arguments)],
            stdin=slave, stdout=slave, stderr=slave, cwd=cwd, start_new_session=True,
            env=os.environ | {"PYTHONPATH": PYTHONPATH, "TERM": "xterm"},
            preexec_fn=take_terminal,
        )  # fmt: skip
        os.close(slave)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._master)

    def type(self, keys):
        os.write(self._master, keys.encode())

    def expect(self, *words):
        """Return the first of these words that is shown, and forget what was shown up to it."""
        end = time.monotonic() + PATIENCE_S
        while True:
            found = [(self.shown.index(word), word) for word in words if word in self.shown]
            if found:
                at, word = min(found)
                self.shown = self.shown[at + len(word) :]
                return word
            assert time.monotonic() < end, f"none of {words} was shown, but {self.shown}"
            assert self._read(0.2) or self.process.poll() is None, f"it ended without {words}: {self.shown}"

    def end(self):
        """Return the exit code and what was shown last."""
        end = time.monotonic() + PATIENCE_S
        while self.process.poll() is None and time.monotonic() < end:
            self._read(0.2)
        while self._read(0.1):
            pass
        return self.process.poll(), self.shown

    def _read(self, timeout_s):
        if not select.select([self._master], [], [], timeout_s)[0]:
            return False
        try:
            data = os.read(self._master, 1 << 16)
        except OSError:  # the other side is closed
            time.sleep(0.05)
            return False
        self.shown += data.decode(errors="replace")
        return bool(data)


def take_terminal():
    """Make the terminal of stdin that of the process, and let Ctrl-C end it, as a shell does."""
    import fcntl
    import signal
    import termios

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # tests that run in the background ignore it
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
