"""The half space's stress from the surface down to where nothing arrives."""

import jax.numpy as jnp
import numpy as np

from srsinv.forward.skin import HalfSpace
from tests.reference import exact
from tests.stability.matrix import Case, Group

CELL_M = 1e-4
# |k| from nothing to the shortest wave that cells of CELL_M hold.
K = np.array([0.0, 1e-9, 1.0, 1e3, 1e4, np.pi / CELL_M])


def transfer(v):
    """sigma_x, sigma_z, tau_xz from p and q at the wavenumbers `k`, real and imaginary parts."""
    found = HalfSpace().transfer(v["k"], v["depth_m"])[:3]
    return jnp.stack([found.real, found.imag])


def transfer_reference(v):
    found = [exact.stress(k, v["depth_m"]) for k in v["k"]]
    found = np.array([exact.as_float(one.tolist()) for one in found], complex)
    found = np.moveaxis(found, 0, -1)
    return np.stack([found.real, found.imag])


def depth(cells, hard):
    return Case(f"depth {cells:g} cells", hard, {"k": K, "depth_m": cells * CELL_M}, (1e-14, 1e-5))


GROUPS = (
    Group(
        "half space, transfer",
        transfer,
        transfer_reference,
        (
            depth(0.01, "the film lies on the surface"),
            depth(1000, "every wave but the longest underflows"),
        ),
    ),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound
