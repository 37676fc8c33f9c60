"""The roots of the robust losses over sixty decades of residuals."""

import jax.numpy as jnp
import mpmath as mp
import numpy as np

from srsinv.inverse.nonlinear._loss import Cauchy, Huber, SoftL1
from tests.stability.matrix import Group, HardCase

RESIDUALS = np.array(
    [-1e30, -1e20, -3e6, -50.0, -1.4, -1.3, -1e-2, -1e-20, 1e-3, 2.4, 2e9, 3e9, 1e30]
)


def root_of(loss):
    """The root of each loss over its size, so that every residual counts the same."""

    def model(v):
        return jnp.stack([loss.root(v["r"]) / v["size"]])

    return model


@mp.workdps(60)
def exact_root(name, r):
    size = abs(mp.mpf(float(r)))
    if name == "huber":
        d = mp.mpf(1.345)
        rho = size**2 / 2 if size <= d else d * size - d**2 / 2
    elif name == "soft_l1":
        d = mp.mpf(1.345)
        rho = d**2 * (mp.sqrt(1 + (size / d) ** 2) - 1)
    else:
        d = mp.mpf(2.385)
        rho = d**2 / 2 * mp.log1p((size / d) ** 2)
    return mp.sign(mp.mpf(float(r))) * mp.sqrt(2 * rho)


def reference_of(name):
    def reference(v):
        values = [float(exact_root(name, r) / s) for r, s in zip(v["r"], v["size"], strict=True)]
        return np.array([values])

    return reference


def losses(name, loss):
    size = np.array([float(abs(exact_root(name, r))) for r in RESIDUALS])
    case = HardCase(
        "to 1e30",
        "its square overflows",
        {"r": RESIDUALS, "size": size},
        (16 * 2.2e-16, 16 * 1.2e-7),
    )
    return Group(name, root_of(loss), reference_of(name), (case,), fixed=frozenset({"size"}))


GROUPS = (
    losses("huber", Huber()),
    losses("soft_l1", SoftL1()),
    losses("cauchy", Cauchy()),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound
