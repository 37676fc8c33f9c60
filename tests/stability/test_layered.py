"""Layered skins of all sizes and stiffnesses, against one dense system in many digits."""

import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.layered import Layer, Layered
from srsinv.forward.skin import HalfSpace
from srsinv.forward.viscoelastic import Viscoelastic
from tests.reference import exact, exact_layers
from tests.stability import matrix
from tests.stability.matrix import PRECISIONS, Group, HardCase

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


def response_model(endless):
    """Of p and of q: stress, the surface's displacement times k E; and antiplane stress."""

    def model(v):
        layers, k = skin(v, endless), v["k"][None]
        stress = parts(layers.transfer(k, v["depth_m"]))
        moved = parts(layers.surface_displacement(k) * v["k"] * v["modulus_Pa"][0])
        across = parts(layers.antiplane.transfer(k, v["depth_m"]))
        return stress[:, :, 0], stress[:, :, 1], moved[:, :, 0], moved[:, :, 1], across

    return model


def response_reference(endless):
    def reference(v):
        h = [*v["thickness_m"][:-1], None if endless else v["thickness_m"][-1]]
        layers = list(zip(v["modulus_Pa"], v["nu"], h, strict=True))
        stress, moved = exact_layers.solve(layers, v["depth_m"], v["k"])
        # A film on an interface belongs to the layer above.
        passed = v["depth_m"] > np.cumsum(v["thickness_m"])[:-1] * (1 + 1e-9)
        nu = v["nu"][np.count_nonzero(passed)]
        stress = np.concatenate([stress, nu * (stress[:1] + stress[1:2])])
        across = exact_layers.across(layers, v["depth_m"], v["k"])
        responses = stress[:, 0], stress[:, 1], moved[:, 0], moved[:, 1], across
        return tuple(np.stack([one.real, one.imag])[..., None] for one in responses)

    return reference


MM = 1e-3
# Moduli, Poisson's ratios, and thicknesses in mm.
STACKS = {
    "soft, stiff, soft": ((SOFT, STIFF, SOFT), (0.5, 0.0, 0.5), (1.0, 0.1, 3.0)),
    "stiff, soft, stiff": ((STIFF, SOFT, STIFF), (0.0, 0.5, 0.5), (0.1, 1.0, 1.0)),
    "stiff on soft": ((STIFF, STIFF, SOFT), (0.5, 0.5, 0.5), (0.6, 0.4, 10.0)),
    "soft on stiff": ((SOFT, SOFT, STIFF), (0.5, 0.45, 0.0), (0.5, 0.5, 1.0)),
    "like": ((7e5, 5e4, 3e5), (0.5, 0.3, 0.0), (0.5, 0.5, 1.0)),
    "one, cut thin": ((7e5, 7e5, 7e5), (0.4, 0.4, 0.4), (1e-4, 1e-7, 1.0)),
}
# k times 1 mm, and where the film lies.
PLACES = (
    (1e-9, ("first",)),
    (1e-6, ("surface", "interface")),
    (1e-3, ("first", "last")),
    (0.1, ("surface", "interface")),
    (1.0, ("first", "core")),
    (30.0, ("surface", "last")),
    (1e4, ("interface", "core")),
)


def depth_m(h, film):
    total = np.cumsum(h) * MM
    return {
        "surface": 1e-9,
        "first": 0.6 * total[0],
        "interface": total[0],
        "last": total[1] + 0.3 * h[2] * MM,
        "core": total[2],
    }[film]


def cases():
    for name, (modulus, nu, h) in STACKS.items():
        for kh, films in PLACES:
            for film in films:
                numbers = {
                    "thickness_m": np.array(h) * MM,
                    "modulus_Pa": np.array(modulus),
                    "nu": np.array(nu),
                    "depth_m": depth_m(h, film),
                    "k": kh / MM,
                }
                # What arrives at kz has that condition.
                bounds = tuple((128 + 8 * kh / MM * numbers["depth_m"]) * EPS)
                hard = "moduli 1e8 apart" if name != "like" else "waves of all lengths"
                yield HardCase(f"{name}, kh {kh:g}, film {film}", hard, numbers, bounds)


def relaxing(v):
    skin = Viscoelastic(HalfSpace(0.5, 7e5), v["fractions"], v["times_s"], v["speed_m_per_s"])
    return parts(skin.relative_modulus(v["k"] * v["speed_m_per_s"])), parts(skin.compliance(v["k"]))


def relaxing_reference(v):
    mp = exact.mp
    rows = []
    for k in v["k"]:
        modulus = mp.mpf(1)
        for fraction, time in zip(v["fractions"], v["times_s"], strict=True):
            turn = 1j * mp.mpf(float(k)) * mp.mpf(float(v["speed_m_per_s"])) * mp.mpf(float(time))
            modulus += mp.mpf(float(fraction)) * turn / (1 + turn)
        at_rest = 2 * (1 - mp.mpf(0.25)) / (mp.mpf(7e5) * mp.mpf(float(k)))
        rows.append([modulus + 0j, at_rest / modulus])
    rows = exact.as_float(rows).T
    return tuple(np.stack([one.real, one.imag]) for one in rows.astype(complex))


def relaxes(name, hard, speed, times=(1e-3, 0.1), fractions=(2.0, 0.5), k=(1.0, 300.0)):
    numbers = {
        "k": np.array(k),
        "speed_m_per_s": speed,
        "times_s": np.array(times),
        "fractions": np.array(fractions),
    }
    return HardCase(name, hard, numbers, tuple(float(bound) for bound in 32 * EPS))


# Values here, derivatives in test_more_derivatives.py.
ON_A_CORE = Group(
    "layers on a core", response_model(False), response_reference(False), tuple(cases())
)
GROUPS = (
    Group(
        "viscoelastic",
        relaxing,
        relaxing_reference,
        (
            relaxes("at rest", "the frequency is 0", 0.0),
            relaxes("slow", "no lag is left", 1e-12),
            relaxes("at its peak", "w tau is 1", 1000.0, (1e-3, 1e-3), k=(1.0, 1.0)),
            relaxes("backward", "the lag turns", -0.05),
            relaxes("1e6 relaxation speeds", "no lag is left", 1e6, (1.0, 1.0)),
            relaxes("lightning", "w tau squared overflows", 1e15, (1e6, 1e-12)),
            relaxes("glass", "the modulus rises a million times", 0.1, fractions=(1e6, 0.0)),
        ),
    ),
    Group("layers on a half space", response_model(True), response_reference(True), tuple(cases())),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound


@pytest.mark.parametrize("precision", PRECISIONS)
def test_layers_on_a_core(precision, margin):
    margin(*matrix.within_bounds(ON_A_CORE, precision))
