"""Bonded elastic layers over a half space or a rigid core, in plane strain
(docs/explanation/physics/layers.md)."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Complex, Float

from ..compiled import compiled
from ..errors import BadInput, echo, mapping, number, refuse
from ..grid import as_real
from ..quantities import quantity
from .antiplane import Antiplane, AntiplaneHalfSpace
from .kernel_table import KAPPA, integral_over_x, kernel
from .layer_stack import LayerStack
from .skin import HalfSpace, Skin

LONGEST = 1e-30  # rad/m, for k = 0

# Stress that is even in x, and has a real transfer; the others are odd, and imaginary.
EVEN = np.array([[True, False], [True, False], [False, True], [True, False]])
ACROSS = np.array([False, True])  # the same of tau_xieta and tau_etaz


class Layer(eqx.Module):
    """One homogeneous elastic layer.

    - `thickness_m`: None for a half space, which only the last layer can be.

    Raises `BadInput` for a thickness or a modulus that is not positive and for a ratio outside
    [0, 1/2].
    """

    thickness_m: Float[Array, ""] | None
    youngs_modulus_Pa: Float[Array, ""]
    poisson_ratio: Float[Array, ""]

    def __init__(self, thickness_m=None, youngs_modulus_Pa=7e5, poisson_ratio=0.5):
        if thickness_m is not None:
            wanted = "a positive thickness in metres, or null for a half space"
            thickness_m = number("skin.layers thickness_m", thickness_m, wanted, above=0)
        self.thickness_m = None if thickness_m is None else as_real(thickness_m)
        wanted = "a positive modulus in Pa"
        self.youngs_modulus_Pa = as_real(
            number("skin.layers youngs_modulus_Pa", youngs_modulus_Pa, wanted, above=0)
        )
        wanted = "a number between 0 and 0.5"
        self.poisson_ratio = as_real(
            number("skin.layers poisson_ratio", poisson_ratio, wanted, least=0, most=0.5)
        )


Layers = Sequence[Layer | Mapping[str, Any]] | Mapping[str, Mapping[str, Any]]
_KEYS = {"thickness_m", "youngs_modulus_Pa", "poisson_ratio"}


class Layered(Skin):
    """Layers from the surface down, each bonded to the next one.

    The last is a half space where it has no thickness; else it is bonded to a rigid core. A film
    that lies on an interface belongs to the layer above. Differentiable in the depth and in every
    number of the layers; a traced depth below the core's face counts as at that face.

    Built from layers, or mappings of what they take, in a list or by name. Raises `BadInput` when
    there is no layer, and for a layer without thickness above another one.
    """

    layers: tuple[Layer, ...]

    def __init__(self, layers: Layers):
        listed = layers_of(layers, "skin")
        for at, layer in enumerate(listed[:-1], 1):
            refuse(
                layer.thickness_m is None,
                f"Layer {at} of {len(listed)} in skin.layers has no thickness_m: give one in "
                "metres, as only the last layer can be a half space.",
            )
        self.layers = tuple(listed)

    @property
    def surface_modulus_Pa(self) -> float | None:
        return float(self.layers[0].youngs_modulus_Pa)

    @property
    def words(self) -> str:
        def one(layer: Layer) -> str:
            thick = layer.thickness_m
            kind = "a half space" if thick is None else f"{float(thick) * 1e3:.4g} mm"
            return (
                f"{kind} of {quantity(float(layer.youngs_modulus_Pa), 'Pa')} "
                f"(Poisson's ratio {float(layer.poisson_ratio):.4g})"
            )

        base = [] if self._endless else ["a rigid core"]
        return " on ".join([one(layer) for layer in self.layers] + base)

    def check_depth(self, depth_m) -> None:
        """Raise `BadInput` for a film inside the rigid core, unless values are traced."""
        thickness = [layer.thickness_m for layer in self.layers]
        if self._endless or any(isinstance(value, Tracer) for value in [depth_m, *thickness]):
            return
        total, depth = float(np.sum([np.asarray(h) for h in thickness])), float(depth_m)
        refuse(
            depth > total * (1 + 1e-6),
            f"The film's depth_m is {depth:.6g} and the rigid core begins at {total:.6g} m: give "
            "a smaller depth, or thicker skin.layers.",
        )

    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "4 2 k"]:
        """Stress [Pa/Pa] at `depth_m` per unit traction exp(ikx).

        At k = 0 the limit, with nothing where the transfer is odd: sigma_x from q on a half space
        jumps there.
        """
        self.check_depth(depth_m)
        return self._transfer(k, as_real(depth_m))

    def surface_displacement(self, k: Float[Array, " k"]) -> Complex[Array, "2 2 k"]:
        """Displacement of the surface (u along x, w into the finger) per unit traction exp(ikx)
        [m/Pa], for k of either sign but not 0."""
        return self._displacement(k)

    def compliance(self, k: Float[Array, " k"]) -> Float[Array, " k"]:
        return self._displacement(k)[1, 0].real

    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        """Stress [Pa/Pa] at (x, depth_m) under unit uniform traction on |x'| < width_m/2: that of a
        half space in closed form, and the layers' addition to it."""
        self.check_depth(depth_m)
        return self._strip(x, as_real(depth_m), as_real(width_m))

    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "4 2 x"]:
        self.check_depth(depth_m)
        return self._slope(x, as_real(depth_m), as_real(width_m))

    @property
    def _endless(self) -> bool:
        return self.layers[-1].thickness_m is None

    @compiled
    def _transfer(self, k, depth_m) -> Array:
        stack = LayerStack(self.layers, depth_m)
        moved, down = stack.at_the_film(_never_zero(k))
        nu = stack.film_of(stack.poisson_ratio)
        shear_t, shear_s, normal_t, normal_s = down
        stretch_t, stretch_s, _, _ = moved

        def rows(stretch, shear, normal):
            along = (nu * normal - 2 * stretch) / (1 - nu)
            return jnp.stack([along, normal, shear, nu * (along + normal)])

        # (T, S) is (0, -1) for p = 1 and (i s, 0) for q = 1, and tau_xz is i s T.
        from_p = -rows(stretch_s, shear_s, normal_s)
        from_q = rows(stretch_t, -shear_t, normal_t)
        real = jnp.stack([from_p, from_q], axis=1)
        return jnp.where(EVEN[..., None], real + 0j, 1j * jnp.sign(k)[None, None] * real)

    @compiled
    def _displacement(self, k) -> Array:
        wavenumber, stack = _never_zero(k), LayerStack(self.layers, as_real(0.0))
        surface = stack.surface(wavenumber)
        unit = stack.softness[-1] / (stack.unit_Pa * wavenumber)
        uu, uw, ww = unit * surface.uu, 1j * jnp.sign(k) * unit * surface.uw, unit * surface.ww
        return jnp.stack([jnp.stack([uw, uu + 0j]), jnp.stack([ww + 0j, -uw])])

    @property
    def antiplane(self) -> "AntiplaneLayers":
        return AntiplaneLayers(self.layers)

    @compiled
    def _strip(self, x, depth_m, width_m) -> Array:
        own, half, transfer = self._added(depth_m)
        step = ends(integral_over_x(transfer, EVEN), x, depth_m, width_m)
        return own * half.strip_response(x, depth_m, width_m) + step

    @compiled
    def _slope(self, x, depth_m, width_m) -> Array:
        own, half, transfer = self._added(depth_m)
        step = ends(kernel(transfer, EVEN), x, depth_m, width_m)
        return own * half.strip_slope(x, depth_m, width_m) + step / depth_m

    def _added(self, depth_m):
        """A fraction of a half space of the material around the film, that half space, and the
        layers' addition to it at |k| depth = `KAPPA`.

        Below a far stiffer layer little of the half space's stress remains, and it would cancel.
        """
        stack = LayerStack(self.layers, depth_m)
        own, nu = stack.passed_on, stack.film_of(stack.poisson_ratio)
        half = HalfSpace(cast(Any, nu))
        k = as_real(KAPPA) / depth_m
        return own, half, self._transfer(k, depth_m) - own * half.transfer(k, depth_m)


class AntiplaneLayers(Antiplane):
    """Shear along features on the same layers: tau = G dv/dz with v'' = k^2 v in each."""

    layers: tuple[Layer, ...]

    @compiled
    def transfer(self, k: Float[Array, " k"], depth_m: Float[Array, ""]) -> Complex[Array, "2 k"]:
        stack = LayerStack(self.layers, depth_m)
        film, down = stack.antiplane(_never_zero(k))
        along = film * down / stack.film_of(stack.softness)
        return jnp.stack([-1j * jnp.sign(k) * along, -down + 0j])

    @compiled
    def strip_response(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        own, transfer = self._added(depth_m)
        step = ends(integral_over_x(transfer, ACROSS), x, depth_m, width_m)
        return own * AntiplaneHalfSpace().strip_response(x, depth_m, width_m) + step

    @compiled
    def strip_slope(
        self, x: Float[Array, " x"], depth_m: Float[Array, ""], width_m: Float[Array, ""]
    ) -> Float[Array, "2 x"]:
        own, transfer = self._added(depth_m)
        step = ends(kernel(transfer, ACROSS), x, depth_m, width_m)
        return own * AntiplaneHalfSpace().strip_slope(x, depth_m, width_m) + step / depth_m

    def _added(self, depth_m):
        """As `Layered._added`, for antiplane shear."""
        k, own = as_real(KAPPA) / depth_m, LayerStack(self.layers, depth_m).passed_on
        return own, self.transfer(k, depth_m) - own * AntiplaneHalfSpace().transfer(k, depth_m)


def ends(primitive, x, depth_m, width_m):
    """Increment of `primitive` from one end of a strip to the other."""
    return primitive((x + width_m / 2) / depth_m) - primitive((x - width_m / 2) / depth_m)


def _never_zero(k):
    """|k|, replaced at k = 0 by a value so small that every transfer has its limit there."""
    zero = k == 0
    return jnp.where(zero, LONGEST, jnp.abs(jnp.where(zero, 1.0, k)))


def layers_of(layers: Any, key: str) -> list[Layer]:
    """Layers as they are or as mappings of what [`Layer`][] takes, in a list or by name. Raises
    `BadInput` for anything else, which it calls `key`.layers."""
    if not isinstance(layers, Mapping | list | tuple) or not layers:
        raise BadInput(
            f"{key}.layers is {echo(layers)}: give a list of layers, or a mapping of them by "
            "name, from the surface down."
        )
    named = layers.items() if isinstance(layers, Mapping) else enumerate(layers)
    return [_layer(f"{key}.layers.{name}", node) for name, node in named]


def _layer(key: str, node: Any) -> Layer:
    if isinstance(node, Layer):
        return node
    known = mapping(key, node, f"a mapping of {', '.join(sorted(_KEYS))}")
    missing, unknown = sorted(_KEYS - set(known)), sorted(set(known) - _KEYS, key=str)
    refuse(bool(unknown), f"{key} has no key {unknown and unknown[0]!r}: give {', '.join(_KEYS)}.")
    refuse(bool(missing), f"{key} lacks {missing and missing[0]}: give it in SI units.")
    return Layer(**known)
