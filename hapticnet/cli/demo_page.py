"""``hapticnet demo --page``: a slave and a master with the live page, until Ctrl-C."""

import os
import webbrowser
from typing import TYPE_CHECKING, Final

from hapticnet.cli.pages import PAGE, address_in
from hapticnet.codec.registry import split_codec
from hapticnet.options import AUTO
from hapticnet.runtime.processes import Child

if TYPE_CHECKING:
    from hapticnet.cli.console import Console


OPEN_IT: Final = "open this address in a browser; press Ctrl-C to end"


def play_on_page(page: str, console: "Console", *, seed: int, device: str, codec: str, rate_hz: float) -> None:
    """Run both processes, open the page, and pass on what the master says, until it ends.

    The browser is a child of this process, which has normal priority; a child of the master would inherit its
    real-time priority.

    Raises
    ------
    UnavailableError
        When a process cannot do its part; repeats what it said.
    """
    slave = Child(
        ["slave", "--listen", "127.0.0.1:0", "--scene", f"paper:{seed}", "--add-codec", split_codec(codec)[0]]
    )
    master: Child | None = None
    try:
        arguments = ["master", "--connect", slave.address(), "--name", "demo", "--seed", str(seed)]
        arguments += ["--page" if page == AUTO else f"--page={page}", "--device", device]
        master = Child([*arguments, "--codec", codec, "--rate", str(rate_hz)])
        for line in master.lines():
            file, said = address_in(line.partition(": ")[2])
            console.say(said, needed=bool(file))
            if said.startswith(PAGE):
                console.say("press Ctrl-C to end" if open_browser(file) else OPEN_IT)
        master.finish()
    except KeyboardInterrupt:  # this is how it ends
        console.say("ended")
    finally:
        for child in (master, slave):
            if child is not None:
                child.end()


def open_browser(url: str) -> bool:
    """Open a page where there is a browser with a window; return whether there is one.

    All users of this machine can read the command line of a browser, so the address must have no token.
    """
    if not any(os.environ.get(name) for name in ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY")):
        return False
    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
