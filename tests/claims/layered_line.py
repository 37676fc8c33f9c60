"""How far the stress under one cell of traction on a layered skin is from exact layers, over ratios
of moduli of 1e-5 to 1e5, film depths in the skin and below it, and the whole line (two minutes):
the largest error of the stress and of its slope along x, over the peak of each component.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from srsinv.forward.layered import Layer, Layered
from srsinv.jobs.trials import Row
from tests.claims.study import Study, combinations
from tests.reference.exact_layers_line import LayersOnLine

SKIN_M, SKIN_PA, CELL_M, POISSON_RATIO = 1e-3, 7e5, 1e-4, 0.5
# The skin's modulus over its base's, and the film's depth.
CONTRASTS = (1e-5, 1e-3, 0.02, 50.0, 1e3, 1e4, 1e5)
DEPTHS_M = (0.1e-3, 0.75e-3, 1.5e-3)
DEPTHS_ALONG = np.array([0, 0.3, 0.7, 1, 2, 4, 4.9, 5, 5.1, 6, 10, 30, 1e2, 1e3, 1e4, 1e5])


@eqx.filter_jit
def _ours(skin, x, depth):
    width = jnp.asarray(CELL_M)
    return skin.strip_response(x, depth, width), skin.strip_slope(x, depth, width)


def errors(contrast: float, depth_m: float) -> Row:
    """The largest error of the stress and of its slope, of six components each over its peak."""
    base = SKIN_PA / contrast
    skin = Layered(
        [Layer(SKIN_M, SKIN_PA, POISSON_RATIO), Layer(None, base, POISSON_RATIO)],
    )
    layers = [(SKIN_PA, POISSON_RATIO, SKIN_M), (base, POISSON_RATIO, None)]
    exact = LayersOnLine(layers, depth_m, step=0.06, digits=45)
    x = depth_m * np.concatenate([DEPTHS_ALONG, -DEPTHS_ALONG[1:4]])
    row = {}
    both = _ours(skin, jnp.asarray(x), jnp.asarray(depth_m))
    for name, ours in zip(("stress", "slope"), both, strict=True):
        wanted = exact.strip(x, CELL_M, name == "slope")
        off = np.abs(np.asarray(ours)[:3] - wanted).max(-1) / np.abs(wanted).max(-1)
        row[f"error_{name}"] = float(off.max())
    return row


STUDY = Study("layered_line", errors, lambda: combinations(contrast=CONTRASTS, depth_m=DEPTHS_M))
