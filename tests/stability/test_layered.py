"""Layered skins of all sizes and stiffnesses, against one dense system in many digits."""

import jax.numpy as jnp
import numpy as np

from srsinv.forward.layered import Layer, Layered
from tests.reference import exact_layers
from tests.stability.matrix import PRECISIONS, Case, Group

EPS = np.array([np.finfo(precision).eps for precision in PRECISIONS])
SOFT, STIFF = 1e-2, 1e6


def skin(v, endless):
    last = len(v["nu"]) - 1
    return Layered(
        [
            Layer(None if endless and j == last else v["thickness_m"][j], v["modulus_Pa"][j], nu)
            for j, nu in enumerate(v["nu"])
        ]
    )


def parts(value):
    return jnp.stack([value.real, value.imag])


def felt(endless):
    """Of p and of q: stress, the surface's displacement times k E; and antiplane stress."""

    def model(v):
        layers, k = skin(v, endless), v["k"][None]
        stress = parts(layers.transfer(k, v["depth_m"]))
        moved = parts(layers.surface_displacement(k) * v["k"] * v["modulus_Pa"][0])
        across = parts(layers.antiplane.transfer(k, v["depth_m"]))
        return stress[:, :, 0], stress[:, :, 1], moved[:, :, 0], moved[:, :, 1], across

    return model


def felt_reference(endless):
    def reference(v):
        h = [*v["thickness_m"][:-1], None if endless else v["thickness_m"][-1]]
        layers = list(zip(v["modulus_Pa"], v["nu"], h, strict=True))
        stress, moved = exact_layers.solve(layers, v["depth_m"], v["k"])
        # A film on an interface belongs to the layer above.
        passed = v["depth_m"] > np.cumsum(v["thickness_m"])[:-1] * (1 + 1e-9)
        nu = v["nu"][np.count_nonzero(passed)]
        stress = np.concatenate([stress, nu * (stress[:1] + stress[1:2])])
        across = exact_layers.across(layers, v["depth_m"], v["k"])
        found = stress[:, 0], stress[:, 1], moved[:, 0], moved[:, 1], across
        return tuple(np.stack([one.real, one.imag])[..., None] for one in found)

    return reference


STACKS = {
    "soft plate, stiff plate": ((SOFT, STIFF, SOFT), (0.5, 0.0, 0.5), (1.0, 0.1, 3.0)),
    "stiff, soft": ((STIFF, SOFT, STIFF), (0.0, 0.5, 0.5), (0.1, 1.0, 1.0)),
    "stiff on soft": ((STIFF, STIFF, SOFT), (0.5, 0.5, 0.5), (0.5, 0.5, 10.0)),
    "soft on stiff": ((SOFT, SOFT, STIFF), (0.5, 0.45, 0.0), (0.5, 0.5, 1.0)),
    "like": ((7e5, 5e4, 3e5), (0.5, 0.3, 0.0), (0.5, 0.5, 1.0)),
}


def cases():
    for name, (modulus, nu, h) in STACKS.items():
        for kh in (1e-6, 1e-3, 0.1, 1.0, 30.0, 1e4):
            for film in ("surface", "first", "interface", "last"):
                h = np.asarray(h)
                depth = {"surface": 1e-6, "first": 0.6 * h[0], "interface": h[0], "last": h[0] + h[1] + 0.3 * h[2]}[film]
                v = {"thickness_m": h * 1e-3, "modulus_Pa": np.asarray(modulus), "nu": np.asarray(nu), "depth_m": depth * 1e-3, "k": kh / 1e-3}
                yield Case(f"{name}, kh {kh:g}, film {film}", "", v, tuple(1e-13 / 2.2e-16 * EPS))

GROUPS = (
    Group("endless", felt(True), felt_reference(True), tuple(cases())),
    Group("core", felt(False), felt_reference(False), tuple(cases())),
)
