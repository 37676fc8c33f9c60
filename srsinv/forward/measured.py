"""Film elements whose response to a line load was measured.

The kernel K(x) [C m/N] of a film, the charge under a unit line load that is x away, is that of the
film as stated, in closed form, and a correction that was measured, tabulated where it is not zero:
beyond the table the far field is the stated film's, times a factor.
"""

from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Complex, Float

from ..errors import refuse
from ..grid import as_real
from .film import Film, Kernel, StressAt
from .operator import POINTS, lagrange

SPLINE = 7  # order of the spline that is integrated


class KernelTable(eqx.Module):
    """A kernel of p and of q [C m/N] at even places x, zero beyond both ends.

    - `start_m`, `spacing_m` [m]: of the places; `values` (2, m), which end at nothing, and
      `integral` (2, m) [C m^2/N], from the first place on.

    Between the places by the polynomial through the 8 nearest ones.
    """

    start_m: Float[Array, ""]
    spacing_m: Float[Array, ""]
    values: Float[Array, "2 m"]
    integral: Float[Array, "2 m"]

    @classmethod
    def of(cls, x_m: Float[np.ndarray, " m"], values: Float[np.ndarray, "2 m"]) -> "KernelTable":
        """The table of these values at even places x."""
        integral = integral_of(x_m, values)
        spacing = (x_m[-1] - x_m[0]) / (x_m.size - 1)
        return cls(as_real(x_m[0]), as_real(spacing), as_real(values), as_real(integral))

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "2 k"]:
        """The Fourier transform at k [rad/m]; zero beyond what the places resolve."""
        x = self.start_m + self.spacing_m * jnp.arange(self.values.shape[1])
        waves = jnp.exp(-1j * k[None] * x[:, None])
        is_resolved = jnp.abs(k) * self.spacing_m < jnp.pi
        return jnp.where(is_resolved, self.spacing_m * (self.values @ waves), 0.0)

    def strip_response(
        self, x: Float[Array, " x"], width_m: Float[Array, ""], order: int
    ) -> Float[Array, "2 x"]:
        """Charge at x under unit traction on |x'| < width_m/2, or its slope where `order` is 1."""
        table = self.values if order else self.integral
        return self._at(table, x + width_m / 2) - self._at(table, x - width_m / 2)

    def _at(self, table: Float[Array, "2 m"], x: Float[Array, " x"]) -> Float[Array, "2 x"]:
        count = table.shape[1]
        at = jnp.clip((x - self.start_m) / self.spacing_m, 0.0, count - 1.0)
        first = jnp.clip(jnp.floor(at) - (POINTS // 2 - 1), 0, count - POINTS)
        index = first.astype(int)[:, None] + np.arange(POINTS)[None]
        return jnp.sum(lagrange(at - first, POINTS)[None] * table[:, index], axis=-1)


def integral_of(
    x_m: Float[np.ndarray, " m"], values: Float[np.ndarray, "*rows m"]
) -> Float[np.ndarray, "*rows m"]:
    """The integral of rows of values at even places, from the first place on."""
    spline = scipy.interpolate.make_interp_spline(x_m, values, SPLINE, axis=-1)
    return np.asarray(spline.antiderivative()(x_m))


class MeasuredFilm(Film):
    """A film element whose kernel was measured: `far` times that of the film as stated, of p and of
    q (2,), and a tabulated `correction`.

    `stated_effects`: how many of its first effects along the line the measured kernel includes;
    those after them act on what was measured, too.
    """

    far: Float[Array, "2"]
    correction: KernelTable
    stated_effects: int = eqx.field(static=True)

    def __init__(self, far: Any, correction: KernelTable, stated_effects: int, **film: Any):
        super().__init__(**film)
        refuse(
            self.turn_rad is not None,
            "A film with a measured kernel is turned in the plane, where its kernel is not known: "
            "measure it in its own axes and give turn_rad=0.",
        )
        self.far, self.correction, self.stated_effects = as_real(far), correction, stated_effects

    @classmethod
    def of(cls, film: Film, far: Any, correction: KernelTable) -> "MeasuredFilm":
        """The film as stated, all its effects included in what was measured."""
        stated = {name: getattr(film, name) for name in Film.__dataclass_fields__}
        return cls(far, correction, len(film.effects), **stated)

    @property
    def stated(self) -> Film:
        """The film as it is stated, without what was added since."""
        fields: dict[str, Any] = {name: getattr(self, name) for name in Film.__dataclass_fields__}
        fields["effects"] = self.effects[: self.stated_effects]
        return cast(Any, Film)(**fields)

    def charge_transfer(
        self, stress: Complex[Array, "4 c k"], k: Float[Array, " k"]
    ) -> Complex[Array, "c k"]:
        charge = self.far[:, None] * jnp.tensordot(self.charge_per_stress(), stress, 1)
        own, later = self.effects[: self.stated_effects], self.effects[self.stated_effects :]
        for effect in (*own, *self.place):
            charge = charge * effect.transfer(k)[None]
        charge = charge + self.correction.transfer(k)
        for effect in later:
            charge = charge * effect.transfer(k)[None]
        return self.turned(charge)

    def charge_response(
        self, stress: StressAt, x: Float[Array, " x"], width_m: Float[Array, ""], order: int
    ) -> Float[Array, "c x"]:
        correction: Kernel = lambda x: self.correction.strip_response(x, width_m, order)  # noqa: E731
        for effect in self.effects[self.stated_effects :]:
            correction = effect.spread(correction)
        stated = super().charge_response(stress, x, width_m, order)
        return self.far[:, None] * stated + self.turned(correction(x))
