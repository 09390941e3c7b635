"""The scene: a needle on one axis against layers of tissue.

Each layer is in one of three states.

- No contact: the tip is in front of its surface.
- Contact: the tip is past the surface, which follows it, and the layer pushes back.
- Penetrated: its elastic force has exceeded its breach force. That force is gone and the surface returns to its rest
  position, at once or with a recovery time. When the tip is withdrawn behind the surface, the layer heals and must be
  breached again.

Layers act in parallel: a tip can reach a second surface before it has breached the first. Each layer responds to its
own indentation and breaks at its own breach force; the needle feels the sum. A tip that crosses several surfaces in one
step breaches them from front to back; those whose force stays within their breach force remain in contact.

A surface that recovers while the needle is in its way comes to rest against the tip and presses on it as it relaxes
further: contact starts at zero force, grows with the distance of the surface past the tip, and can breach a layer
although the needle does not move.
"""

import heapq
from bisect import insort
from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Final

from hapticnet.checks import axes_of
from hapticnet.errors import SampleError
from hapticnet.samples import LARGEST_COMPONENT, ForceSample, PositionSample, checked_vector, new_tuple
from hapticnet.scene.ahead import REACH_M, LayerAhead
from hapticnet.scene.layer import Layer, Needle, bound_of
from hapticnet.scene.settings import Contact, SceneSettings, Tissue, front_to_back
from hapticnet.scene.vibration import LONGEST_STROKE_US, Vibrations
from hapticnet.stiffness_bound import StiffnessBound

if TYPE_CHECKING:
    from hapticnet.scene.base import Vibrate

_rest_m = attrgetter("rest_m")


class Scene:
    """Tissues and a needle, advanced by position samples.

    A step evaluates only the layers that can exert a force, from front to back. Layers the tip has not reached wait in
    a list; layers it has pierced wait in a heap, ordered by the position behind which they heal. While the tip stays
    between the nearest of both, the layers are not searched.

    Raise SettingsError if there is no tissue, or if two share a rest position. Layers are announced (`ahead`) as far as
    `reach_m` from the tip.
    """

    axes: Final = 1

    def __init__(self, tissues: Sequence[Tissue], *, name: str = "scene", reach_m: float = REACH_M) -> None:
        self.name = name
        self.reach_m = reach_m
        self.tissues = front_to_back(tissues)
        self.breaches = 0  # number of breaches so far. `reset` does not change it.
        self._depends_on_time = any(tissue.depends_on_time for tissue in self.tissues)
        self.reset()

    def reset(self) -> None:
        """Withdraw the needle and heal every tissue."""
        self._vibrations = Vibrations() if any(tissue.ring_hz for tissue in self.tissues) else None
        self.vibration: Vibrate | None = None if self._vibrations is None else self._vibrations.samples
        self._broken: list[Tissue] = []  # in the newest step, if they ring
        self._stamp_us = -LONGEST_STROKE_US  # so that the first step strikes nothing
        self.force_n = 0.0  # the newest force [N]
        self._bound: StiffnessBound | None = None
        self._needle = Needle()
        self._layers = [Layer(tissue, self._needle) for tissue in self.tissues]
        self._reached = 0
        self._felt: list[Layer] = []
        self._passed: list[tuple[float, float, Layer]] = []
        self._back_m = -LARGEST_COMPONENT
        self._ahead_m = self._layers[0].rest_m

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force on a needle; SampleError, and no change, if its tip is not finite or has more axes."""
        position_m = sample.position_m
        if len(position_m) != 1:
            raise SampleError(f"position has {axes_of(len(position_m))}; the scene has 1")
        tip_m = position_m[0]
        if self._depends_on_time and -LARGEST_COMPONENT <= tip_m <= LARGEST_COMPONENT:
            self._needle.advance(sample.t_us, tip_m)
        if not self._back_m <= tip_m < self._ahead_m:  # also true of NaN, which _regroup rejects
            self._regroup(sample)
        before_m = self._needle.tip_m
        self._needle.tip_m = tip_m
        force_n = 0.0
        for layer in self._felt:
            layer_n = layer.feel(tip_m)
            if layer_n is None:
                layer_n = self._breach(layer, tip_m)
            force_n += layer_n
        self.force_n = force_n
        if self._vibrations is not None:
            self._ring(self._vibrations, sample.t_us, tip_m, before_m)
        return new_tuple(ForceSample, (sample.t_us, (force_n,)))

    def copy(self) -> "Scene":
        """Return a scene in the same state."""
        other = Scene(self.tissues, name=self.name, reach_m=self.reach_m)
        other.breaches, other.force_n = self.breaches, self.force_n
        other._vibrations = other.vibration = None  # what is only tried is not felt
        other._needle.follow(self._needle)
        of: dict[float, Layer] = {}
        for layer, mine in zip(other._layers, self._layers, strict=True):
            layer.follow(mine)
            of[mine.rest_m] = layer
        other._reached, other._back_m, other._ahead_m = self._reached, self._back_m, self._ahead_m
        other._felt = [of[layer.rest_m] for layer in self._felt]
        other._passed = [(back_m, rest_m, of[rest_m]) for back_m, rest_m, _ in self._passed]
        return other

    @property
    def settings(self) -> SceneSettings:
        """Its settings."""
        return SceneSettings(name=self.name, tissues=self.tissues)

    def stiffness_bound(self) -> StiffnessBound | None:
        """Return the stiffness bound around the tip; None if a layer has none.

        It is valid while the tip is in its box: nothing breaks or heals there.
        """
        tip_m = self._needle.tip_m
        if self._bound is None or not self._bound.contains((tip_m,)):
            felt = [layer for layer in self._felt if layer.is_felt]
            passed = [layer for _, _, layer in self._passed]
            ahead_m = self._layers[self._reached].rest_m if self._reached < len(self._layers) else LARGEST_COMPONENT
            self._bound = bound_of(felt, passed, ahead_m, tip_m)
        return self._bound

    def surfaces_m(self) -> tuple[float, ...]:
        """Return the position [m] of each surface, front to back."""
        return tuple(layer.surface_m(self._needle.tip_m) for layer in self._layers)

    def contacts(self) -> tuple[Contact, ...]:
        """Return the contact of the needle with each tissue, front to back."""
        return tuple(layer.contact(self._needle.tip_m) for layer in self._layers)

    def ahead(self) -> tuple[LayerAhead, ...]:
        """Return the layers within `reach_m` of the tip, the nearest first, and those that it presses on."""
        tip_m = self._needle.tip_m
        near = [
            layer
            for layer in self._layers
            if abs(layer.rest_m - tip_m) <= self.reach_m or (layer.is_felt and layer.rest_m <= tip_m)
        ]
        return tuple(layer.ahead() for layer in sorted(near, key=lambda layer: abs(layer.rest_m - tip_m)))

    def _breach(self, layer: Layer, tip_m: float) -> float:
        """Pierce `layer` and return its remaining force [N]."""
        left_n = layer.breach(tip_m)
        self.breaches += 1
        if self._vibrations is not None:
            self._broken.append(layer.tissue)
        self._await_withdrawal(layer)
        self._back_m = LARGEST_COMPONENT  # so that the next step regroups
        self._bound = None
        return left_n

    def _ring(self, vibrations: Vibrations, t_us: int, tip_m: float, before_m: float) -> None:
        """Let what the newest step has touched or broken ring."""
        elapsed_us = t_us - self._stamp_us
        self._stamp_us = t_us
        for tissue in self._broken:
            vibrations.strike(t_us, tissue.breach_m_s2, tissue.ring_hz, tissue.ring_decay_per_s)
        self._broken.clear()
        for layer in self._layers:
            if not layer.breached and before_m <= layer.surface.position_m() < tip_m:
                vibrations.touch(t_us, elapsed_us, tip_m - before_m, layer.tissue)

    def _await_withdrawal(self, layer: Layer) -> None:
        # A surface only moves back toward rest, so its present position is a bound. No two layers rest at the same
        # position, so the heap never compares layers.
        heapq.heappush(self._passed, (-layer.surface.position_m(), layer.rest_m, layer))

    def _regroup(self, sample: PositionSample) -> None:
        """Find the layers that can exert a force at `sample`, and the limits within which that set stays the same."""
        tip_m = _checked_tip_m(sample)
        self._bound = None  # it may be from long ago
        felt = [layer for layer in self._felt if layer.is_felt]
        while self._passed and tip_m < -self._passed[0][0]:
            _, _, layer = heapq.heappop(self._passed)
            if tip_m >= layer.surface.position_m():
                self._await_withdrawal(layer)
            else:
                if not layer.is_felt:
                    insort(felt, layer, key=_rest_m)
                layer.heal()
        while felt and tip_m < felt[-1].rest_m:
            felt.pop()
            self._reached -= 1
        layers = self._layers
        while self._reached < len(layers) and layers[self._reached].rest_m <= tip_m:
            felt.append(layers[self._reached])
            self._reached += 1
        self._felt = felt
        self._ahead_m = layers[self._reached].rest_m if self._reached < len(layers) else LARGEST_COMPONENT
        self._back_m = max(
            layers[self._reached - 1].rest_m if self._reached else -LARGEST_COMPONENT,
            -self._passed[0][0] if self._passed else -LARGEST_COMPONENT,
        )


def _checked_tip_m(sample: PositionSample) -> float:
    return checked_vector(sample.position_m, "position")[0]
