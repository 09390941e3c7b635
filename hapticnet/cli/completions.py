"""What the shell offers for the values of options and arguments; imports wait until it asks."""

from collections.abc import Callable, Iterable
from typing import Final


def codec_names(incomplete: str) -> list[str]:
    """Return the codecs, with those of installed packages."""
    from hapticnet.codec.registry import all_codecs, register_installed_codecs

    register_installed_codecs()
    return _starting(incomplete, all_codecs())


def scene_names(incomplete: str) -> list[str]:
    """Return the built-in scenes; for anything else, the shell completes files."""
    from hapticnet.scene.sources import scene_names as presets

    return _starting(incomplete, ["paper", *presets()])


def channel_names(incomplete: str) -> list[str]:
    """Return the presets of the emulated network."""
    from hapticnet.channel.spec import PRESETS

    return _starting(incomplete, PRESETS)


def device_names(incomplete: str) -> list[str]:
    """Return the kinds of devices and the serial ports of this machine."""
    from serial.tools import list_ports

    ports = [f"serial:{port.device}" for port in list_ports.comports()]
    return _starting(incomplete, ["sim", "simavr", "none", "serial:auto", *ports])


def operator_names(incomplete: str) -> list[str]:
    """Return the kinds of operators."""
    return _starting(incomplete, ["scripted", "palpation", "trace:", "page", "udp:"])


def verb_names(incomplete: str) -> list[str]:
    """Return the first words of all verbs."""
    import typer

    from hapticnet.cli import app

    command = typer.main.get_command(app)
    return _starting(incomplete, getattr(command, "commands", ()))


def _starting(incomplete: str, names: Iterable[str]) -> list[str]:
    return sorted(name for name in names if name.startswith(incomplete))


COMPLETIONS: Final[dict[str, Callable[[str], list[str]]]] = {  # completions by the name of the parameter
    "codec": codec_names,
    "scene": scene_names,
    "device": device_names,
    "operator": operator_names,
    "verb": verb_names,
    "channel_out": channel_names,
    "channel_in": channel_names,
}
