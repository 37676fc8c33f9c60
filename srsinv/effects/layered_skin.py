"""A skin of layers in place of the half space, on a rigid core or on a half space."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from ..forward.layered import Layer, Layered, layers_of
from ..forward.scenario import Scenario
from ._effect import Effect, Order
from ._reference import ReferenceSpectra

MOST_STIFFENING = 0.9  # of the compliance, by the layers below: such a skin is never left out
ECHO = 1.5  # at most 1.35 times the form below, over stacks of ratios from 0.01 to 100


class LayeredSkin(Effect):
    """`layers` from the surface down, each a mapping of thickness_m, youngs_modulus_Pa and
    poisson_ratio; by name or as a list.

    A last layer of thickness null is a half space below; without one the last layer is bonded to a
    rigid core. The layers take the place of the skin's own modulus and ratio, in the stress and in
    contact. Raises `BadInput` for values that no layer can have.
    """

    order: ClassVar[Order] = Order.SKIN
    of_sensor: ClassVar[bool] = True
    skin: Layered

    def __init__(self, layers: Sequence[Mapping[str, Any]] | Mapping[str, Mapping[str, Any]]):
        self.skin = Layered(layers_of(layers, "effects.layered_skin"))

    def is_defined_in(self, scenario: Scenario) -> bool:
        return scenario.sensor.skin.half_space is None

    def apply(self, scenario: Scenario) -> Scenario:
        for film in scenario.sensor.elements:
            self.skin.check_depth(film.depth_m)
        return scenario.with_skin(self.skin)

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # The half space's field, of order (1 + k H) e^{-kH} at an interface at depth H, comes back
        # to the film over H - z and to the surface over H, by the contrast there.
        films = reference.scenario.sensor.elements
        depth = np.array([float(film.depth_m) for film in films])[:, None]
        k, change, at_surface = reference.k, 0.0, np.zeros_like(reference.k)
        for height, contrast in self._interfaces():
            echo = ECHO * contrast * (1 + 2 * k * height) ** 2
            change = change + echo * np.exp(-2 * k * np.maximum(height - depth, 0.0))
            at_surface = at_surface + echo * np.exp(-2 * k * height)
        inside = reference.relative_rms_of_modulus(
            change * np.abs(reference.read(reference.largest))
        )
        bound = inside + self._across(reference, depth[:, 0])
        return bound + self._contact_change_bound(reference, at_surface)

    def _across(self, reference: ReferenceSpectra, depth) -> float:
        """Bound on the change by the Poisson's ratio of the film's layer: sigma_y alone."""
        below = [[0.0, *(height for height, _ in self._interfaces())]] * depth.size
        at = [int(np.searchsorted(tops, z) - 1) for tops, z in zip(below, depth, strict=True)]
        last = len(self.skin.layers) - 1
        own = np.array([float(self.skin.layers[min(i, last)].poisson_ratio) for i in at])
        was = reference.scenario.sensor.skin.half_space
        assert was is not None, "a reference is without effects"
        in_plane = reference.film_stress[:, :2].sum(axis=1)
        weight = reference.weights[:, 3] * (own - float(was.poisson_ratio))
        return reference.relative_rms(reference.read(weight[:, None] * in_plane))

    def _contact_change_bound(self, reference: ReferenceSpectra, echo) -> float:
        """Bound on the change of the contact, by the top layer's modulus and the compliance of all
        layers."""
        if not reference.has_contact:
            return 0.0
        top, was = self.skin.layers[0], reference.scenario.sensor.skin.half_space
        assert was is not None, "a reference is without effects"
        own, before = (
            float(each.youngs_modulus_Pa) / (1 - float(each.poisson_ratio) ** 2)
            for each in (top, was)
        )
        # The echo yields more or less: whichever changes more.
        ratios = 1 + echo, 1 - np.minimum(echo, MOST_STIFFENING)
        changes = [reference.relative_contact_change(before / own * each) for each in ratios]
        return max(changes)

    def _interfaces(self) -> list[tuple[float, float]]:
        """Depth [m] of every interface, and how much its sides differ, at most 1."""
        interfaces, depth = [], 0.0
        below = [*self.skin.layers[1:], None]
        for upper, lower in zip(self.skin.layers, below, strict=True):
            if upper.thickness_m is None:
                break
            depth += float(upper.thickness_m)
            interfaces.append((depth, 1.0 if lower is None else _contrast(upper, lower)))
        return interfaces


def _contrast(upper: Layer, lower: Layer) -> float:
    nus = [float(each.poisson_ratio) for each in (upper, lower)]
    moduli = [float(each.youngs_modulus_Pa) for each in (upper, lower)]
    shear = [modulus / (1 + nu) for modulus, nu in zip(moduli, nus, strict=True)]
    return min(1.0, abs(shear[0] - shear[1]) / sum(shear) + abs(nus[0] - nus[1]))
