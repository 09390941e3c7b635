"""``hapticnet codecs``: the compression schemes there are."""

from typing import Any

from hapticnet.cli import options


def codecs(json: options.Json = False) -> None:
    """List the codecs with their rules and parameters."""
    import json as json_module

    from hapticnet.codec.registry import describe_codecs

    listed: list[dict[str, Any]] = describe_codecs()
    if json:
        print(json_module.dumps(listed, indent=2))
        return
    for codec in listed:
        print(f"{codec['name']}: {codec['summary']}")
        for parameter in codec["parameters"]:
            print(f"    {parameter['name']} = {parameter['default']:g}: {parameter['meaning']}")
        if codec["needs_position"]:
            print("    (its rule depends on the tool's motion)")
