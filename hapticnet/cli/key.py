"""``hapticnet key``: make and show the keys of sealed sessions."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.protocol.keys import MasterEntry

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


@app.command("list", short_help="List the masters that the slave admits.")
def list_masters(file: options.MastersArgument = None, json: options.Json = False) -> None:
    """List the masters that the slave admits, with their limits, after the same checks as at the start of the slave."""
    import os

    from hapticnet.cli.console import deliver, print_table
    from hapticnet.files import user_path
    from hapticnet.protocol.key_files import default_key, default_masters, load_key
    from hapticnet.runtime.trust import read_guests

    key = user_path(os.environ.get("HAPTICNET_KEY") or default_key())
    path = file or default_masters(key)
    roster, _ = read_guests(path, load_key(key).public if key.exists() else None)
    rows = [_as_json(entry) for entry in roster]
    if json:
        deliver({"file": str(path), "masters": rows}, as_json=True, file=None)
    elif rows:
        print_table([list(rows[0]), *(list(row.values()) for row in rows)])
    else:
        print(f"{path} admits no master; 'hapticnet key new' on a master's host prints what to add")


def _as_json(entry: "MasterEntry") -> dict[str, Any]:
    """Return an entry without its pre-shared key, which is a secret."""
    from hapticnet.protocol.keys import NO_PSK, format_key

    return {
        "name": entry.name,
        "public": format_key(entry.public),
        "psk": entry.psk != NO_PSK,
        "scene": entry.scene,
        "fastest_rate_hz": entry.fastest_rate_hz,
        "most_sessions": entry.most_sessions,
    }
