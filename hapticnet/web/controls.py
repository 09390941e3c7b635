"""Settings that a page may change during a run: threshold, codec, and delay and loss of the emulated channel."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import BernoulliLoss, ChannelSettings
from hapticnet.codec.registry import codec_parameters, describe_codecs, make_codec
from hapticnet.errors import PeerError, SettingsError
from hapticnet.node.master import MasterNode
from hapticnet.web.messages import Change

if TYPE_CHECKING:
    from hapticnet.perception import WeberLaw

CHANNEL_KEYS: Final = ("delay_ms", "loss_percent")
ASK_EVERY_US: Final = 200_000  # shortest time [µs] between two requests for a session because of a change


class Controls:
    """Apply changes to a running master; `channels` (feedback, forward) are needed to change delay and loss."""

    def __init__(self, node: MasterNode, channels: Sequence[tuple[Emulator[Any], ChannelSettings]] = ()) -> None:
        self._node = node
        self._wanted: tuple[str, WeberLaw] | None = None
        self._asked_us = -ASK_EVERY_US
        self._channels = list(channels)
        # This parses docstrings, which takes too long between two ticks.
        self._codecs = [{"name": codec["name"], "summary": codec["summary"]} for codec in describe_codecs()]
        self.adjustable = ("multiplier", "codec", *(CHANNEL_KEYS if channels else ()))  # settings that can be changed

    def codecs(self) -> list[dict[str, str]]:
        """Return names and rules of the codecs to choose from."""
        return self._codecs

    def report(self) -> dict[str, Any]:
        """Return the present settings, for the state message."""
        codec = self._node.codec
        channel = self._channels[0][1] if self._channels else ChannelSettings()
        return {
            "codec": codec.name,
            "parameters": codec_parameters(codec),
            "multiplier": codec.law.multiplier,
            "weber_fraction": codec.law.weber_fraction,
            "floor_n": codec.law.floor_n,
            "delay_ms": channel.delay_us / 1000,
            "loss_percent": 100 * channel.loss.mean if channel.loss is not None else 0.0,
        }

    def apply(self, change: Change) -> None:
        """Change all named settings, or none; PeerError if one cannot be changed, or there is no such codec."""
        for key in Change.__dataclass_fields__:
            if getattr(change, key) is not None and key not in self.adjustable:
                raise PeerError(f"{key} cannot be changed in this run")
        if change.codec is not None or change.multiplier is not None:
            self._want(change)
        if change.delay_ms is not None or change.loss_percent is not None:
            self._change_channels(change)

    def work(self, now_us: int) -> None:
        """Ask for a session with the wanted codec, at most every `ASK_EVERY_US`, because sliders are dragged."""
        if self._wanted is not None and not 0 <= now_us - self._asked_us < ASK_EVERY_US:
            (codec, law), self._wanted = self._wanted, None
            self._asked_us = now_us
            self._node.change(codec=codec, law=law)

    def _want(self, change: Change) -> None:
        now = self._node.codec
        codec, law = self._wanted or (now.name, now.law)
        codec = change.codec or codec
        try:
            if change.multiplier is not None:
                law = replace(law, multiplier=change.multiplier)
            make_codec(codec, law).decoder(self._node.axes)
        except SettingsError as error:
            raise PeerError(str(error)) from error
        self._wanted = codec, law

    def _change_channels(self, change: Change) -> None:
        for number, (channel, settings) in enumerate(self._channels):
            if change.delay_ms is not None:
                settings = replace(settings, delay_us=round(1000 * change.delay_ms))
            if change.loss_percent is not None:
                share = change.loss_percent / 100
                settings = replace(settings, loss=BernoulliLoss(share) if share else None)
            channel.change(settings)
            self._channels[number] = channel, settings
        back, out = (settings.describe() for _, settings in self._channels)
        self._node.emulate(out, back)
