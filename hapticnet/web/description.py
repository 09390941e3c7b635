"""What a page is told about the run when it opens, and about the scene when it changes.

The two views differ here: what the operator view is not told, it cannot show.
"""

from typing import TYPE_CHECKING, Any

from hapticnet import __version__
from hapticnet.node.master import MasterNode
from hapticnet.operator.live import LiveHand
from hapticnet.web import messages, requests
from hapticnet.web.controls import Controls
from hapticnet.web.messages import View
from hapticnet.web.mirror import Mirror, scene_called

if TYPE_CHECKING:
    from hapticnet.web.page import PageSettings


class Description:
    """The run and its scene."""

    def __init__(self, node: MasterNode, controls: Controls, settings: "PageSettings") -> None:
        self.mirror: Mirror | None = None  # the copy of the slave's scene; None while it is not known
        self._node = node
        self._controls = controls
        self._settings = settings

    @property
    def range_m(self) -> tuple[float, float]:
        """Positions [m] that are shown, and between which a hand may move the needle."""
        if self.mirror is not None:
            return self.mirror.range_m
        hand = self._settings.hand
        return hand.range_m if hand is not None else (0.0, 0.1)

    def follow_scene(self, name: str, *, is_new: bool) -> bool:
        """Use the scene that the slave calls `name`; return whether it is another one than before."""
        before = self.mirror.settings if self.mirror is not None else None
        known = scene_called(name, self._settings.scene) if self._node.axes == 1 else None
        if known is None:
            self.mirror = None
        elif is_new or known != before:
            self.mirror = Mirror(known, is_new=is_new)
        if self.mirror is not None and self._settings.hand is not None:
            self._settings.hand.set_range(*self.mirror.range_m)
        return known != before or known is None

    def hello(self, view: View) -> str:
        """Return the first message to a page."""
        settings = self._settings
        content = hello(view, settings.source, settings.hand)
        if view == "watch":
            content |= {
                "rate_hz": 1e6 / self._node.position_period_us,
                "axes": self._node.axes,
                "device": settings.device,
                "largest_n": self._node.largest_n,
                "master": self._node.settings.name,
                "hapticnet": __version__,
                "columns": messages.COLUMNS,
                "history_s": messages.HISTORY_S,
                "codecs": self._controls.codecs(),
                "limits": requests.LIMITS,
                "adjustable": self._controls.adjustable,
                "operator_url": settings.operator_url,
            }
        return messages.text("hello", **content)

    def scene(self, view: View) -> str:
        """Return the message about the scene."""
        tissues = self.mirror.settings.tissues if self.mirror is not None else ()
        content: dict[str, Any] = {"known": self.mirror is not None, "range_m": self.range_m}
        if view == "watch":
            content["name"] = self._node.scene_name
            content["tissues"] = [
                {
                    "rest_m": tissue.rest_position_m,
                    "name": tissue.name,
                    "stiffness_n_per_m": tissue.stiffness_n_per_m,
                    "breach_force_n": tissue.breach_force_n,
                }
                for tissue in tissues
            ]
        else:
            content["tissues"] = [{"rest_m": tissue.rest_position_m} for tissue in tissues]
        return messages.text("scene", **content)


def hello(view: View, source: str, hand: LiveHand | None) -> dict[str, Any]:
    """Return what the first message to any page tells.

    `source`: where the positions come from, in a word. `hand`: the hand that a page may take, or None.
    """
    settings = None if hand is None else hand.settings
    return {
        "version": messages.VERSION,
        "view": view,
        "messages_per_s": messages.MESSAGES_PER_S,
        "hand": {
            "source": source,
            "speed_m_per_s": None if settings is None else settings.speed_m_per_s,
            "delay_ms": None if settings is None else settings.delay_us / 1000,
            "repeat_ms": messages.REPEAT_MS,
        },
    }
