"""The scene: a needle on one axis against layers of tissue.

Each layer is, from the needle's side, in one of three states.

- No contact: the tip is before its surface.
- Contact: the tip is past the surface, which follows it, and the layer pushes back.
- Penetrated: its elastic force has exceeded its breach force. That force is gone and the surface returns to
  its rest position, at once or with a recovery time. When the tip is withdrawn behind the surface the layer
  has healed and must be breached anew.

Layers act in parallel: a tip can reach a second surface before it has breached the first, each layer
answers its own indentation and gives way by its own force alone, and the needle feels their sum. A tip that
crosses several surfaces in one step meets and breaches them from front to back; those whose force stays
within their breach force remain in contact.

A surface that recovers while the needle rests in its way comes to lie against the tip and presses on it as
it relaxes further: contact starts without force, grows with the surface's way past the tip, and can breach
a layer under a needle that does not move.
"""

import heapq
from bisect import insort
from collections.abc import Sequence
from operator import attrgetter

from hapticnet.errors import SampleError
from hapticnet.samples import LARGEST_COMPONENT, ForceSample, PositionSample, checked_vector
from hapticnet.scene.layer import Layer
from hapticnet.scene.needle import Needle
from hapticnet.scene.tissue import Contact, Tissue, front_to_back

_rest_m = attrgetter("rest_m")


class Scene:
    """Tissues under a needle, stepped by position samples.

    A step evaluates the layers that can be felt, from front to back, and no others. The rest wait: those the
    tip has not reached, in a row; those it is through, in a heap by the position behind which the tip must
    come to heal them. While the tip stays between the nearest of either there is nothing to look for.

    Parameters
    ----------
    tissues
        In any order; no two with the same rest position.
    name
        What people call the scene.

    Attributes
    ----------
    tissues
        The tissues from front to back.
    breaches
        Breaches so far. It never decreases, not even by `reset`.
    force_n
        The newest force [N].

    Raises
    ------
    SettingsError
        When there is no tissue, or when two share a rest position.
    """

    axes = 1

    def __init__(self, tissues: Sequence[Tissue], *, name: str = "scene") -> None:
        self.name = name
        self.tissues = front_to_back(tissues)
        self.breaches = 0
        if any(tissue.depends_on_time for tissue in self.tissues):
            self.step = self._step_in_time  # type: ignore[method-assign]
        self.reset()

    def reset(self) -> None:
        """Take the needle out and make every tissue whole."""
        self.force_n = 0.0
        self._needle = Needle()
        self._layers = [Layer(tissue, self._needle) for tissue in self.tissues]
        self._reached = 0
        self._felt: list[Layer] = []
        self._passed: list[tuple[float, float, Layer]] = []
        self._back_m = -LARGEST_COMPONENT
        self._ahead_m = self._layers[0].rest_m

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force on a needle whose tip has come to `sample`.

        Raises
        ------
        SampleError
            When the position is not finite or has more than one axis; the scene is as it was before.
        """
        try:
            (tip_m,) = sample.position_m
        except ValueError:
            tip_m = _checked_tip_m(sample)  # refuses it
        if not self._back_m <= tip_m < self._ahead_m:  # true of NaN too, which is refused there
            self._regroup(sample)
        self._needle.tip_m = tip_m
        force_n = 0.0
        for layer in self._felt:
            layer_n = layer.feel(tip_m)
            if layer_n is None:
                layer_n = self._breach(layer, tip_m)
            force_n += layer_n
        self.force_n = force_n
        return ForceSample(sample.t_us, (force_n,))

    def surfaces_m(self) -> tuple[float, ...]:
        """Return where each surface is [m], front to back."""
        return tuple(layer.surface_m(self._needle.tip_m) for layer in self._layers)

    def contacts(self) -> tuple[Contact, ...]:
        """Return what the needle does to each tissue, front to back."""
        return tuple(layer.contact(self._needle.tip_m) for layer in self._layers)

    def _step_in_time(self, sample: PositionSample) -> ForceSample:
        """Stand in for `step` where a tissue depends on time."""
        position_m = sample.position_m
        if len(position_m) == 1 and -LARGEST_COMPONENT <= position_m[0] <= LARGEST_COMPONENT:
            self._needle.advance(sample.t_us, position_m[0])
        return Scene.step(self, sample)  # refuses anything else

    def _breach(self, layer: Layer, tip_m: float) -> float:
        """Let the needle through `layer` and return the force [N] that is left of it."""
        left_n = layer.breach(tip_m)
        self.breaches += 1
        self._await_withdrawal(layer)
        self._back_m = LARGEST_COMPONENT  # so that the next step regroups
        return left_n

    def _await_withdrawal(self, layer: Layer) -> None:
        # A surface only ever moves back to its rest, so where it is now bounds where it will be. No two
        # layers rest at the same position, so the heap never compares layers.
        heapq.heappush(self._passed, (-layer.surface.position_m(), layer.rest_m, layer))

    def _regroup(self, sample: PositionSample) -> None:
        """Find the layers that can be felt at `sample`, and how far the tip may go before others can."""
        tip_m = _checked_tip_m(sample)
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
    vector = checked_vector(sample.position_m, "position")
    if len(vector) != Scene.axes:
        raise SampleError(f"position has {len(vector)} axes; the scene has {Scene.axes}")
    return vector[0]
