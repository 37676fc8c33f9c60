"""What a sensor is designed for: the error that is expected of a task, differentiable in the
sensor.

All follow from the whitened model N^(-1/2) G(k) of one period of a line, (element, component,
wavenumber), and from no data. Each wavenumber adds its own information and noise is independent
from element to element, so that a phase exp(i k offset) of one element drops out.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from srsinv.errors import BadInput, refuse
from srsinv.forward.contact import cell_compliance, press
from srsinv.forward.scene import SurfaceScene, TractionScene
from srsinv.forward.skin import Skin
from srsinv.forward.surface import Ridge
from srsinv.forward.traction import PressedStrip, UniformStrip
from srsinv.grid import Line, half_spectrum_weights
from srsinv.inverse.line.spectral import orthogonalised, posterior

CELLS_IN_RIDGE = 4  # cells of the contact across a ridge, at least
STRIPS = PressedStrip, UniformStrip
Whitened = Complex[Array, "e c k"]


class Task(eqx.Module):
    """Base of tasks: `__call__` gives the expected error of a sensor's whitened model."""

    quantity: ClassVar[str]  # name of the error, as in the metrics
    units: ClassVar[str]

    @abc.abstractmethod
    def __call__(self, whitened: Whitened) -> Float[Array, ""]:
        """The error, in `units`."""


class TractionError(Task):
    """The rms posterior standard error of p and q over their rms, less their means, which a rate
    signal does not determine.

    The traction is random with the power spectra `power` (component, k) [Pa^2], and p and q are
    independent: C(k) = (G^H N^-1 G + S^-1)^-1, Wiener's. With `friction` q is mu p, and the error
    is that of p, the one component.
    """

    quantity = "error"
    units = "1"
    power: Float[Array, "c k"]
    friction: Float[Array, ""] | None
    n: int = eqx.field(static=True)

    def __call__(self, whitened: Whitened) -> Float[Array, ""]:
        if self.friction is not None:
            whitened = whitened[:, :1] + self.friction * whitened[:, 1:]
        model = orthogonalised(whitened, np.ones(self.power.shape[0], bool))
        nothing = [jnp.zeros_like(column[0]) for column in model.columns]
        solved = posterior(model, nothing, list(1 / jnp.sqrt(self.power)))
        variance = sum(stderr**2 for stderr in solved.stderr(self.n))
        total = jnp.sum(self.power[:, 1:] @ half_spectrum_weights(self.n)[1:])
        return jnp.sqrt(variance / total)


class ParameterError(Task):
    """`factor` times the Cramer-Rao standard error of the last of some parameters, none of which
    is known: `slopes` (parameter, component, k) is the traction's spectrum by each.

    The information of the parameters is the sum over wavenumbers of J^H N^-1 J. Elimination of one
    parameter after another leaves that of the last.
    """

    slopes: Complex[Array, "parameter c k"]
    factor: Float[Array, ""]
    n: int = eqx.field(static=True)

    def __call__(self, whitened: Whitened) -> Float[Array, ""]:
        columns = jnp.einsum("eck,pck->pek", whitened, self.slopes)
        columns = columns * np.sqrt(half_spectrum_weights(self.n))
        size = jnp.sqrt(jnp.sum(jnp.abs(columns) ** 2, axis=(1, 2)))
        # Scaled to one: pressures are in thousands of Pa, positions in thousandths of a metre.
        scaled = columns / jax.lax.stop_gradient(size)[:, None, None]
        information = jnp.einsum("aek,bek->ab", scaled.conj(), scaled).real
        for _ in range(len(self.slopes) - 1):
            first = information[0]
            information = (information - jnp.outer(first, first) / first[0])[1:, 1:]
        return self.factor / jax.lax.stop_gradient(size[-1]) / jnp.sqrt(information[0, 0])


class LeastHeight(ParameterError):
    """The height of a ridge [m] that a matched filter detects, at a known position: the d' that it
    needs times the standard error of the height.

    A low ridge leaves the skin on the plate, and its traction is proportional to its height.
    """

    quantity = "least_height"
    units = "m"


class DirectionError(ParameterError):
    """The standard error of the traction's direction arctan(q/p) [deg] on a strip whose pressure,
    width, position and friction mu are unknown: that of mu over 1 + mu^2."""

    quantity = "direction_stderr"
    units = "deg"


def least_height(
    line: Line, fine: Line, scene: Any, strength: float, height_m: float | None = None
) -> LeastHeight:
    """Detection of a ridge by the strength d': of a low one, or by the traction per height of one
    of `height_m`, which the skin need not touch everywhere.

    `fine`: the line with its cells so much finer that they resolve the ridge. Raises `BadInput` for
    another scene than one ridge, and for one that is flat or not resolved.
    """
    ridge = scene.surface.only(Ridge) if isinstance(scene, SurfaceScene) else None
    if ridge is None:
        raise BadInput("design.ridge is not one ridge: give one in design.ridge.surfaces.")
    finer = float(CELLS_IN_RIDGE * line.cell_m / ridge.width_m)
    refuse(
        finer * (1 - 1e-9) > fine.n / line.n,
        f"The cells of the contact are {float(fine.cell_m):g} m wide, but the ridge "
        f"{float(ridge.width_m):g} m: give grid.refinement={int(np.ceil(finer))} or more.",
    )
    height = scene.height(fine)
    top = jnp.max(jnp.abs(height))
    refuse(
        not float(top) > 0,
        "design.ridge is flat within the window: give it a height other than 0 and a place in it.",
    )
    shape = height / top
    if height_m is None:
        p = low_pressure(fine, scene.skin, shape)
    else:
        contact = press(fine, scene.skin, height_m * shape, scene.nominal_pressure_Pa)
        p = (contact.pressure_Pa - scene.nominal_pressure_Pa) / height_m
    cells = p.reshape(line.n, -1).mean(axis=1)
    traction = jnp.stack([cells, scene.surface.base_friction * cells])
    return LeastHeight(jnp.fft.rfft(traction)[None], jnp.asarray(strength), line.n)


def low_pressure(line: Line, skin: Skin, shape: Float[Array, " n"]) -> Float[Array, " n"]:
    """The pressure less its mean per metre of height [Pa/m] of a surface of this `shape`, the skin
    touching everywhere: its displacement is the surface's height."""
    compliance = cell_compliance(line, skin)
    yields = jnp.abs(compliance) > 0
    spectrum = jnp.fft.rfft(shape) / jnp.where(yields, compliance, 1.0)
    return jnp.fft.irfft(jnp.where(yields, spectrum, 0.0), line.n)


def direction_error(line: Line, scene: Any) -> DirectionError:
    """The direction of a strip's traction. Raises `BadInput` for another scene than one pressed
    strip of constant friction."""
    is_plain = isinstance(scene, TractionScene) and not scene.frictions
    strips = [each for each in scene.pressures if isinstance(each, STRIPS)] if is_plain else []
    if len(strips) != 1 or len(scene.pressures) != 1:
        raise BadInput(
            "design.strip is not one strip of constant friction: give one in "
            "design.strip.pressures, and design.strip.frictions={}."
        )
    (strip,), ends = strips, (float(line.x[0]), float(line.x[-1]))
    half, middle = float(strip.width_m) / 2, float(strip.position_m)
    refuse(
        middle - half < ends[0] or middle + half > ends[1],
        f"design.strip reaches from {middle - half:g} to {middle + half:g} m, but the window from "
        f"{ends[0]:g} to {ends[1]:g} m: give it a place within.",
    )

    def unknown(scene: Any) -> list[Any]:
        (own,) = scene.pressures
        return [own.pressure_Pa, own.width_m, own.position_m, scene.base_friction]

    def traction(values: list[Any]) -> Float[Array, "2 n"]:
        return eqx.tree_at(unknown, scene, values).traction(line)

    spectra = jnp.fft.rfft(jnp.stack(jax.jacfwd(traction)(unknown(scene))))
    return DirectionError(spectra, jnp.rad2deg(1 / (1 + scene.base_friction**2)), line.n)
