"""Viscoelastic skin in steady sliding: its surface displacement lags behind a moving load."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..errors import number, refuse
from ..grid import Scalar, as_real
from .antiplane import Antiplane
from .skin import Skin


class Viscoelastic(Skin):
    """An elastic skin all of whose layers relax alike, under a pattern that slides past it.

    A Prony series: at the frequency w every modulus is the wrapped skin's, which is that at rest,
    times m(iw) = 1 + sum_j f_j i w tau_j / (1 + i w tau_j), so that fast it is 1 + sum_j f_j times
    stiffer. Poisson's ratio stays.

    - `skin`: at rest. `fractions` f_j (mode,) and `times_s` tau_j (mode,).
    - `speed_m_per_s`: u of the finger along +x. The pattern is fixed to the surface, so that for
      the skin's material d/dt = u d/dx, w = k u (docs/explanation/physics/relaxation.md).

    The stress inside is the wrapped skin's, as one factor on all moduli leaves it alone for given
    traction; only the surface's displacement lags. Raises `BadInput` for no mode at all, as many
    fractions as times not given, a negative fraction, and a time that is not positive.
    """

    skin: Skin
    fractions: Float[Array, " mode"]
    times_s: Float[Array, " mode"]
    speed_m_per_s: Float[Array, ""]

    def __init__(
        self,
        skin: Skin,
        fractions: Sequence[Any] | Float[Array, " mode"],
        times_s: Sequence[Any] | Float[Array, " mode"],
        speed_m_per_s: Scalar = 0.05,
    ):
        refuse(
            len(fractions) != len(times_s),
            f"skin.fractions has {len(fractions)} values and skin.times_s has {len(times_s)}: give "
            "one fraction for each relaxation time.",
        )
        refuse(
            len(times_s) == 0,
            "skin.times_s has 0 relaxation times: give at least 1, or the elastic skin alone.",
        )
        self.skin = skin
        wanted = "a number that is at least 0, relative to the relaxed modulus"
        fractions = [
            number(f"skin.fractions[{j}]", each, wanted, least=0)
            for j, each in enumerate(fractions)
        ]
        wanted = "a positive time in seconds"
        times_s = [
            number(f"skin.times_s[{j}]", each, wanted, above=0) for j, each in enumerate(times_s)
        ]
        self.fractions, self.times_s = as_real(fractions), as_real(times_s)
        self.speed_m_per_s = as_real(
            number("skin.speed_m_per_s", speed_m_per_s, "a finite speed in m/s")
        )

    @property
    def words(self) -> str:
        stiffer, modes = 1 + float(np.sum(self.fractions)), self.times_s.size
        return (
            f"{self.skin.words}, viscoelastic with {modes} relaxation "
            f"time{'s' if modes > 1 else ''}, {stiffer:.4g} times stiffer when fast, sliding at "
            f"{float(self.speed_m_per_s):.4g} m/s"
        )

    @property
    def relaxes(self) -> bool:
        return True

    def sliding_at(self, speed_m_per_s: Scalar) -> "Viscoelastic":
        return dataclasses.replace(self, speed_m_per_s=as_real(speed_m_per_s))

    @property
    def surface_modulus_Pa(self) -> float | None:
        at_rest = self.skin.surface_modulus_Pa
        return None if at_rest is None else at_rest * (1 + float(jnp.sum(self.fractions)))

    def relative_modulus(self, frequency_rad_per_s: Float[Array, " w"]) -> Complex[Array, " w"]:
        """m(iw) (w,) for w of either sign or 0: storage and loss over the modulus at rest."""
        turns = frequency_rad_per_s[None] * self.times_s[:, None]
        slow = jnp.abs(turns) <= 1
        # With b the smaller one of w tau and its inverse, no square overflows:
        # i a/(1 + i a) = (a^2 + i a)/(1 + a^2) = (1 + i b)/(1 + b^2), b = 1/a.
        b = jnp.where(slow, turns, 1 / jnp.where(slow, 1.0, turns))
        storage, loss = jnp.where(slow, b**2, 1.0) / (1 + b**2), b / (1 + b**2)
        return 1 + jnp.sum(self.fractions[:, None] * (storage + 1j * loss), axis=0)

    def compliance(self, k: Float[Array, " k"]) -> Complex[Array, " k"]:
        """The surface's displacement into the finger per unit pressure exp(ikx) [m/Pa], k > 0: the
        wrapped skin's over m(i k u)."""
        return self.skin.compliance(k) / self.relative_modulus(k * self.speed_m_per_s)

    @property
    def antiplane(self) -> Antiplane:
        return self.skin.antiplane

    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "4 2 k"]:
        return self.skin.transfer(k, depth_m)

    def transfer_once(self, k: np.ndarray, depth_m: float) -> Complex[np.ndarray, "4 2 k"]:
        return self.skin.transfer_once(k, depth_m)

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        return self.skin.strip_response(x, depth_m, width_m)

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        return self.skin.strip_slope(x, depth_m, width_m)
