"""The process that writes recordings: frames come in on stdin, lines for the user go out on stdout.

Signals to the terminal do not reach it. When stdin ends with its node, it completes the files and ends.
"""

import json
import os
import select
import signal
import sys
import time
from typing import Final

from hapticnet.errors import in_words
from hapticnet.recordings.session.archive import Archive
from hapticnet.recordings.session.frames import frame_reader

FLUSH_S: Final = 0.12  # rows reach the file at the latest this long [s] after the pipe
PIPE_BYTES: Final = 1 << 20
STOPPED: Final = "stopped"
FAILED: Final = "failed"
TOLD: Final = "told"
DONE: Final = "done"


def main() -> None:
    """Write recordings until stdin ends; ``argv[1]`` is the limit of the disk space [B]."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)  # the end of stdin ends this process
    archive = Archive(
        lambda reason, is_fault: _say(FAILED if is_fault else STOPPED, reason),
        lambda line: _say(TOLD, line),
        limit_bytes=int(sys.argv[1]),
    )
    try:
        _serve(archive)
    except Exception as error:  # the user gets one line, and written data stay recoverable
        _say(FAILED, f"the writer failed: {in_words(error)}")
    else:
        _say(DONE, str(archive.completed))


def _serve(archive: Archive) -> None:
    reader = frame_reader()
    flushed = time.monotonic()
    while True:
        ready, _, _ = select.select([0], [], [], FLUSH_S)
        if ready:
            data = os.read(0, PIPE_BYTES)
            if not data:
                break
            reader.feed(data)
            for frame in reader:
                archive.take(*frame)
        if time.monotonic() - flushed >= FLUSH_S or not ready:
            archive.flush()
            flushed = time.monotonic()
    archive.finish()


def _say(kind: str, text: str) -> None:
    try:
        os.write(1, json.dumps([kind, text]).encode() + b"\n")
    except OSError:  # the reader is gone
        return


if __name__ == "__main__":
    main()
