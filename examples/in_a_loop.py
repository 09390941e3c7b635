"""A master in a program with a loop of its own and without asyncio: a game, a simulation, a measuring script."""

import sys
import time

import hapticnet as hn


def main(address: str = "127.0.0.1:47800", seconds: float = 3.0) -> float:
    """Move the tool to 30 mm and return the largest force [N]."""
    largest_n = 0.0
    with hn.ThreadedMaster(address, codec="deadband") as master:
        start_s = time.monotonic()
        while (elapsed_s := time.monotonic() - start_s) < seconds and master.ended is None:
            master.position = 0.03 * elapsed_s / seconds  # neither of these two lines waits
            largest_n = max(largest_n, *master.force_n)
            for event in master.take_events():
                print(event)
            time.sleep(0.01)  # the rest of your loop
    print(f"largest force: {largest_n:.2f} N")
    return largest_n


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1:47800")
