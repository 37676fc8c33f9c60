"""Contact: the pressure under a rigid profile pressed into the skin, without friction or adhesion.

Heights are positive into the finger. The skin's surface is displaced by w, everything repeats with
the window, and the mean pressure is given; the skin as a whole moves freely. Then

    gap = w + const - h >= 0,  p >= 0,  p gap = 0,  mean p = nominal.

At nu = 1/2 shear does not move the surface normally (no Dundurs coupling), so that friction leaves
p alone (docs/explanation/physics/contact.md).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Inexact

from ..compiled import compiled
from ..errors import number, refuse
from ..grid import Line, as_real, sinc
from ..status import Status
from . import contact_elastic, contact_viscoelastic
from .contact_conditions import gap_and_error, least_error, times
from .skin import Skin

MUCH_MISSING = 0.02  # of the lag's friction: below, the window is long enough
LEAST_FRICTION = 1e-4  # a friction coefficient below what is measurable


class WakeFriction(NamedTuple):
    """The friction coefficient of the skin's lag alone (contact_wake.py): `in_window`, and the part
    `missing` of it in windows longer by given factors, the first of them 1."""

    in_window: Float[Array, ""]
    missing: Float[Array, " window"]

    @property
    def missing_fraction(self) -> Float[Array, " window"]:
        """Missing fraction of the whole friction."""
        whole = self.in_window + self.missing[0]
        return self.missing / jnp.where(whole == 0, 1.0, whole)

    @property
    def is_much(self) -> bool:
        """Whether too much is missing in the window itself."""
        size = abs(float(self.missing[0]))
        return size > LEAST_FRICTION and float(self.missing_fraction[0]) > MUCH_MISSING


class Contact(eqx.Module):
    """The solution: over cells (n,), pressure [Pa] as cell averages and gap [m] at their centres.

    - `residual`: how far the gap is from zero in contact, or below it elsewhere, at most, over the
      range of the skin's displacement; and with the pressure over the nominal one, over the
      profile's height. `tolerance`: its bound. `iterations`: on the finest cells.
    - `wake`: the friction of a lagging skin that the window leaves out; None: not computed.
    """

    pressure_Pa: Float[Array, " n"]
    gap_m: Float[Array, " n"]
    residual: Float[Array, ""]
    iterations: Float[Array, ""]
    tolerance: float = eqx.field(static=True)
    wake: WakeFriction | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings: iterations that ended too early, and a window shorter than the skin's wake."""
        messages = []
        if not self.converged:
            messages.append(
                f"The contact is not converged: after {int(self.iterations)} iterations the gap "
                f"has an error of {float(self.residual):.2g} of the skin's displacement, and the "
                "pressure is wrong. Use wider cells, or a first layer that is less stiff compared "
                "with the layer below."
            )
        if self.wake is not None and self.wake.is_much:
            messages.append(
                "The skin has not recovered when the window repeats, so the contact meets its own "
                f"wake: {100 * float(self.wake.missing_fraction[0]):.0f} % of the friction by its "
                "lag is missing, and the pressure lies too far back. Set "
                "scene.contact_windows=null, or a longer grid.length_m."
            )
        return tuple(messages)

    @property
    def touching(self) -> Bool[Array | np.ndarray, " n"]:
        """Contact mask."""
        return self.pressure_Pa > 0

    @property
    def converged(self) -> Bool[Array | np.ndarray | np.bool_, ""]:
        """Whether the residual is as small as it has to be."""
        return self.residual <= self.tolerance

    @property
    def status(self) -> Status:
        """How the solution ended."""
        return Status.CONVERGED if bool(self.converged) else Status.STEP_LIMIT


def press(line: Line, skin: Skin, height_m: Float[Array, " n"], nominal_pressure_Pa) -> Contact:
    """The profile `height_m` (n,) at the cell centres, pressed into `skin` with a mean pressure.

    Projected conjugate gradients after Polonsky and Keer (1999), preconditioned on the contact set
    by 1/compliance (|k| for a half space), started from wider cells; full contact by its formula.
    Where the compliance is complex, a sequence of such contacts (contact_viscoelastic.py).
    Differentiable in all that is given, forward and reverse, by the implicit function theorem:
    where a cell is about to touch or to part, the derivative is that of one side.

    Raises `BadInput` for a pressure that is not positive and heights that are not finite, unless
    they are traced. Traced, a pressure of zero or less gives NaN.
    """
    wanted = "a positive pressure in Pa, the mean over the contact window"
    nominal = as_real(number("nominal_pressure_Pa", nominal_pressure_Pa, wanted, above=0))
    if not isinstance(height_m, Tracer):
        refuse(
            not bool(np.isfinite(height_m).all()),
            "The surface's height is not finite everywhere: check its numbers, in metres.",
        )
    compliance = cell_compliance(line, skin)
    pressure, gap, residual, iterations = _solved(height_m, nominal, compliance)
    return Contact(pressure, gap, residual, iterations, least_error(height_m.dtype))


# Compiled as a whole: step by step, called eagerly, every loop would be compiled anew.
@jax.jit
def _solved(height_m, nominal, compliance):
    """Pressure, gap, residual and iterations."""
    # From the crest: differences of heights near it are then exact, and all of a slight contact.
    height = height_m - jax.lax.stop_gradient(jnp.max(height_m))
    solver = contact_viscoelastic if jnp.iscomplexobj(compliance) else contact_elastic
    deviation, iterations = solver.pressure_deviation(height, nominal, compliance)
    gap, residual = gap_and_error(height, nominal, times(compliance, deviation), deviation)
    # Cells out of contact hold -nominal: their pressure is zero to the last digit.
    return nominal + deviation, gap, residual, iterations


@compiled
def cell_compliance(line: Line, skin: Skin) -> Inexact[Array, " k"]:
    """Displacement at the cell centres under cell averages of pressure [m/Pa], at line.k.

    The pressure is the band-limited function with these averages, as on a periodic line. Nothing
    at k = 0: the mean displacement is free.
    """
    k = line.k
    nonzero = k > 0
    safe = jnp.where(nonzero, k, 1.0)
    compliance = jnp.where(nonzero, skin.compliance(safe) / sinc(safe * line.cell_m / 2), 0.0)
    if jnp.iscomplexobj(compliance) and line.n % 2 == 0:
        # The last wavenumber stands for +k and -k at once: only its real part can act.
        compliance = compliance.at[-1].set(compliance[-1].real)
    return compliance


def is_lagging(skin: Skin) -> bool:
    """Whether the skin's displacement lags behind the load, so that its compliance is complex."""
    one = jax.eval_shape(skin.compliance, jnp.ones(1))
    return bool(jnp.issubdtype(one.dtype, jnp.complexfloating))


def refuse_both_ways(skin: Skin) -> None:
    """Raise `BadInput` for a skin whose pressure differs with the way of sliding, which it is built
    for."""
    refuse(
        is_lagging(skin),
        "A viscoelastic skin is modelled for sliding in one direction, but the "
        "motion turns back: leave out viscoelastic_skin, or the effect that turns "
        "the motion back.",
    )
