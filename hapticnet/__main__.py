"""``python -m hapticnet``."""

from hapticnet.cli import main

main()
