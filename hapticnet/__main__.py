"""The ``hapticnet`` command, and ``python -m hapticnet``."""

import sys


def main() -> None:
    """Run the command line; a Ctrl-C while it is still being loaded ends it like any other."""
    try:
        from hapticnet.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
