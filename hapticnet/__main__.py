"""The ``hapticnet`` command, and ``python -m hapticnet``."""

import os
import sys


def main() -> None:
    """Run the command line; a Ctrl-C while it is still being loaded ends it like any other."""
    _fill_standard_streams()
    try:
        from hapticnet.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)


def _fill_standard_streams() -> None:
    """Open the null device where stdin, stdout or stderr is closed.

    Otherwise the next files get their numbers: libuv aborts on that, and messages would be written into sockets.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
            os.set_inheritable(number, True)


if __name__ == "__main__":
    main()
