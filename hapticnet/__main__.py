"""The ``hapticnet`` command, and ``python -m hapticnet``."""

import os
import sys


def main() -> None:
    """Run the command line; Ctrl-C while it is still loading ends it like any other."""
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
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one
            os.set_inheritable(number, True)


def _leave_working_folder() -> None:
    """Do not search the working folder, which ``python -m`` puts first, for modules: a queue.py there is a user's.

    In a checkout that is not installed, that folder holds this package, and is searched last.
    """
    if not sys.flags.safe_path:
        folder = sys.path.pop(0)
        if os.path.dirname(os.path.dirname(os.path.abspath(__file__))) == os.path.abspath(folder):
            sys.path.append(folder)


if __name__ == "__main__":
    _leave_working_folder()
    main()
