"""``hapticnet codecs``: list the compression schemes."""

from typing import Any, Final

from hapticnet import options

WIDEST: Final = 110
"""Longest line that still reads well."""


def codecs(json: options.Json = False) -> None:
    """List the codecs with their rules and parameters."""
    import json as json_module
    import shutil
    import textwrap

    from hapticnet.cli.console import Console
    from hapticnet.codec.registry import CODECS, describe_codecs, register_installed_codecs

    for fault in register_installed_codecs():
        Console("codecs").say(fault)
    listed: list[dict[str, Any]] = describe_codecs()
    if json:
        print(json_module.dumps(listed, indent=2))
        return
    width = min(shutil.get_terminal_size().columns, WIDEST)
    for codec in listed:
        motion = " Its rule depends on the tool's motion." if codec["needs_position"] else ""
        print(textwrap.fill(f"{codec['name']}: {codec['summary']}{motion}", width, subsequent_indent="  "))
        for parameter in codec["parameters"]:
            text = f"{parameter['name']} = {parameter['default']:g}: {parameter['meaning']}"
            print(textwrap.fill(text, width, initial_indent=" " * 4, subsequent_indent=" " * 8))
    if len(listed) == len(CODECS):
        print("Codecs of the literature are a plug-in: examples/literature in the repository of hapticnet")
