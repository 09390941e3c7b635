"""``hapticnet key``: make and show the keys of sealed sessions."""

from typing import Annotated

import typer

from hapticnet import options

app = typer.Typer(no_args_is_help=True, help="Make and show the keys of sealed sessions.")


@app.command(short_help="Make a key for this host; print its public key.")
def new(
    file: options.KeyArgument = None,
    name: Annotated[
        str | None, typer.Option(help="Name of this host in the slave's list; its host name if omitted.")
    ] = None,
) -> None:
    """Make a key for this host, in a file that only you can read, and print its public key.

    An existing file is never overwritten.
    """
    import os
    import sys

    from hapticnet.protocol.key_files import default_key, dump_master, write_key
    from hapticnet.protocol.keys import MasterEntry, format_key, new_key
    from hapticnet.runtime.system import SystemEntropy

    path = file or default_key()
    key = new_key(SystemEntropy())
    entry = MasterEntry(name=os.uname().nodename if name is None else name, public=key.public)
    write_key(path, key)
    print(format_key(key.public), flush=True)
    print(
        f"wrote {path}; it never leaves this host. Above is the public key.\n"
        f"- If a slave runs here, its masters need: --peer-key {format_key(key.public)}\n"
        "- If a master runs here, the slave's list of masters (masters.toml beside the slave's key) needs:\n\n"
        f"{dump_master(entry)}",
        end="",
        file=sys.stderr,
    )


@app.command(short_help="Print the public key of a key file.")
def public(file: options.KeyArgument = None) -> None:
    """Print the public key of a key file."""
    from hapticnet.protocol.key_files import default_key, load_key
    from hapticnet.protocol.keys import format_key

    print(format_key(load_key(file or default_key()).public))
