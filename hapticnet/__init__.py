"""Haptic teleoperation with perceptual deadband compression: ``import hapticnet as hn``.

The names below are the public interface; docs/refer/api.md describes them and docs/index.md shows them at work. They
are imported when first used, so that ``import hapticnet`` is fast.

Follow one force sample through the rooms in the order of the data:
``scene`` → ``codec`` → ``protocol`` → ``channel`` → (UDP) → ``protocol`` → ``codec`` → ``control`` → ``device``.
``docs/build/architecture.md`` walks that way file by file.
"""

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from hapticnet.api.encoding import Comparison, Encoded, Report, compare, encode, make_codec
    from hapticnet.api.link import LinkReport, VirtualLink, virtual_link
    from hapticnet.api.master import Master, ThreadedMaster, TickedMaster
    from hapticnet.api.measures import energy_report, error_report, fewest_holds, fewest_lines, quality_report
    from hapticnet.api.slave import Slave, ThreadedSlave, TickedSlave
    from hapticnet.codec.base import Codec, Decoder, Encoder
    from hapticnet.codec.registry import CODECS
    from hapticnet.errors import (
        FileError,
        HapticnetError,
        PeerError,
        RefusedError,
        SampleError,
        SettingsError,
        UnavailableError,
    )
    from hapticnet.perception import WeberLaw
    from hapticnet.recordings.loading import Recording, load_recording
    from hapticnet.samples import ForceSample, PositionSample

__version__ = "0.2.0"

_HOMES: Final = {
    "hapticnet.api.encoding": ("Comparison", "Encoded", "Report", "compare", "encode", "make_codec"),
    "hapticnet.api.link": ("LinkReport", "VirtualLink", "virtual_link"),
    "hapticnet.api.master": ("Master", "ThreadedMaster", "TickedMaster"),
    "hapticnet.api.measures": ("energy_report", "error_report", "fewest_holds", "fewest_lines", "quality_report"),
    "hapticnet.api.slave": ("Slave", "ThreadedSlave", "TickedSlave"),
    "hapticnet.codec.base": ("Codec", "Decoder", "Encoder"),
    "hapticnet.codec.registry": ("CODECS",),
    "hapticnet.errors": (
        "FileError", "HapticnetError", "PeerError", "RefusedError", "SampleError", "SettingsError", "UnavailableError",
    ),
    "hapticnet.perception": ("WeberLaw",),
    "hapticnet.recordings.loading": ("Recording", "load_recording"),
    "hapticnet.samples": ("ForceSample", "PositionSample"),
}  # fmt: skip

__all__ = [
    "CODECS", "Codec", "Comparison", "Decoder", "Encoded", "Encoder", "FileError", "ForceSample",
    "HapticnetError", "LinkReport", "Master", "PeerError", "PositionSample", "Recording", "RefusedError",
    "Report", "SampleError", "SettingsError", "Slave", "ThreadedMaster", "ThreadedSlave", "TickedMaster",
    "TickedSlave", "UnavailableError", "VirtualLink", "WeberLaw", "__version__", "compare", "encode",
    "energy_report", "error_report", "fewest_holds", "fewest_lines", "load_recording", "make_codec",
    "quality_report", "virtual_link",
]  # fmt: skip


if not TYPE_CHECKING:  # so that a type checker knows the names

    def __getattr__(name: str) -> Any:
        from importlib import import_module

        for home, names in _HOMES.items():
            if name in names:
                return globals().setdefault(name, getattr(import_module(home), name))
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
