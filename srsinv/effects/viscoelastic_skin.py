"""Rubber that relaxes while it slides: contact through E*(iku), a Prony series."""

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Array, Float

from ..errors import echo, number, refuse
from ..forward.scenario import Scenario
from ..forward.viscoelastic import Viscoelastic
from ..grid import as_real
from ._effect import Effect, Order
from ._reference import ReferenceSpectra


class ViscoelasticSkin(Effect):
    """The skin's modulus grows with frequency by `fractions` of the relaxed one, each over its time
    in `times_s`, all its layers alike.

    Along a measured motion the steady sliding is taken at its mean speed. Raises `BadInput` for
    lists of different lengths, negative fractions and times that are not positive.
    """

    order: ClassVar[Order] = Order.SLIDING
    of_sensor: ClassVar[bool] = True
    fractions: Float[Array, " term"]
    times_s: Float[Array, " term"]

    def __init__(self, fractions: Any, times_s: Any):
        for name, values in (("fractions", fractions), ("times_s", times_s)):
            key = f"effects.viscoelastic_skin.{name}"
            listed = isinstance(values, list | tuple) and len(values) > 0
            refuse(
                not listed, f"{key} is {echo(values)}: give a list of numbers, one for each term."
            )
            for value in values:
                number(key, value, "positive numbers, one for each term", above=0)
        refuse(
            len(fractions) != len(times_s),
            f"effects.viscoelastic_skin has {len(fractions)} fractions and {len(times_s)} "
            "times_s: give as many of one as of the other.",
        )
        self.fractions, self.times_s = as_real(fractions), as_real(times_s)

    def is_defined_in(self, scenario: Scenario) -> bool:
        return scenario.sensor.skin.relaxes

    def apply(self, scenario: Scenario) -> Scenario:
        speed = scenario.scan.speed_m_per_s
        skin = Viscoelastic(scenario.sensor.skin, self.fractions, self.times_s, speed)
        return scenario.with_skin(skin)

    def relative_change_bound(self, reference: ReferenceSpectra) -> float:
        # Stress inside stays as it is; where a surface is pressed on, p goes as the modulus.
        if not reference.has_contact:
            return 0.0
        turn = 1j * reference.k * reference.speed_m_per_s * np.asarray(self.times_s)[:, None]
        stiffer = np.asarray(self.fractions) @ (turn / (1 + turn))
        return reference.relative_contact_change(1 / (1 + stiffer))
