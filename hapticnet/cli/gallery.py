"""``hapticnet gallery``: the demonstrations for a talk, each one click in a browser."""

from typing import TYPE_CHECKING

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.web.gallery import Demonstration


def gallery(page: options.Page = None, quiet: options.Quiet = False) -> None:
    """Serve five demonstrations for a talk, each one click in a browser, until Ctrl-C.

    Opening a demonstration starts it and ends the previous one; it ends 20 s after its last page has closed.
    """
    from hapticnet.cli.console import Console
    from hapticnet.cli.pages import listen_for, say_addresses, until_signal
    from hapticnet.runtime.system import run

    console = Console("gallery", quiet=quiet)
    sock, access = listen_for(page, ("watch",), console)
    from hapticnet.web.gallery import Gallery

    say_addresses({"watch it here: ": "watch"}, access, console)
    console.say("press Ctrl-C to end")
    run(until_signal(Gallery(access, sock, Processes, console.warn)))
    console.say("ended")


class Processes:
    """A running demonstration: a slave and a master with a page, as child processes.

    Raises UnavailableError if one of them does not start.
    """

    def __init__(self, wanted: "Demonstration") -> None:
        from hapticnet.cli.pages import address_in, address_of
        from hapticnet.errors import UnavailableError
        from hapticnet.runtime.processes import Child
        from hapticnet.runtime.udp import HostPort, bound_address, listen

        with listen(HostPort("127.0.0.1", 0)) as sock:  # a free port, so that both can start at once
            place = str(bound_address(sock))
        ours = ["--connect", place, "--name", "gallery", "--page=127.0.0.1:0"]
        master = Child(["master", *ours, *wanted.master])
        slave = Child(["slave", "--listen", place, *wanted.slave])
        self._children = master, slave
        try:
            slave.address()
            found = (address_in(line)[0] for line in master.lines())
            file = next((each for each in found if each.endswith("/watch.html")), None)
            if file is None:
                master.finish()  # it says why it has failed
                raise UnavailableError("the master has ended")
            self.url = address_of(file)  # of its page, with the token
        except BaseException:
            self.end()
            raise

    def has_ended(self) -> bool:
        """Return whether one of the processes has ended."""
        return any(child.poll() for child in self._children)

    def end(self) -> None:
        """End both."""
        for child in self._children:
            child.end()
