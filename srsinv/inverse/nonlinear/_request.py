"""Arguments of a fit, checked and converted for the search."""

from collections.abc import Collection, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...compiled import compiled
from ...errors import BadInput, of_kind, refuse
from ...known import array_module, is_traced
from ._loss import loss_of
from ._noise import whitener
from ._parameters import Parameters, flat_mapping, on_host, real
from ._search import Objective
from ._solvers import Optimistix, Solver

UNTRACED = (
    "fit_many works outside jit, vmap and grad: there, take jax.vmap of srsinv.fit over the data."
)


def checked_solver(solver: Solver | None, **counts: int) -> Solver:
    for name, count in counts.items():
        whole = isinstance(count, int) and count > 0
        refuse(not whole, f"{name} is {count!r}: give a whole number from 1.")
    solver = Optimistix() if solver is None else solver
    return of_kind("solver", solver, Solver, "Optimistix(), OptaxLBFGS() or JaxoptLBFGSB()")


def checked_data(y) -> Any:
    sentence = f"The data are no array of real numbers but {type(y).__name__}: give one."
    return array_module(y).atleast_1d(real(y, sentence))


def filled(data: Any, observed: Any) -> Any:
    """The data with zeros in place of invalid ones."""
    if is_traced(data, observed):
        return jnp.where(observed, data, 0.0)
    bad = observed & ~np.isfinite(data)
    refuse(
        bool(bad.any()),
        f"The data have {int(bad.sum())} values that are nan or infinite: give them "
        "infinite noise to leave them out, or correct them.",
    )
    return np.where(observed, data, 0.0)


NOTHING = 1e-8  # of the largest datum: where most are less, their median is no scale


def data_unit(data: Any, observed: Any) -> Any:
    """Unit of a residual whose noise is not known: the data's median size, which is robust to
    outliers, or the largest where most are zero; a power of two, which changes no digit. In the
    data's own unit single precision cannot square 1e30."""
    if is_traced(data, observed):
        size = jax.lax.stop_gradient(jnp.max(jnp.where(observed, jnp.abs(data), 0.0)))
        return jnp.where(size > 0, 2.0 ** jnp.round(jnp.log2(jnp.where(size > 0, size, 1.0))), 1.0)
    sizes = np.abs(data)[..., np.broadcast_to(observed, data.shape[-observed.ndim :])]
    median, most = np.median(sizes), np.max(sizes)
    size = median if median > NOTHING * most else most
    return float(2.0 ** np.round(np.log2(size))) if size > 0 else 1.0


def objective_of(
    model: Any, unknowns: Parameters, data, noise, priors, loss
) -> tuple[Objective, bool]:
    whiten, observed = whitener(noise, data.shape)
    data = filled(data, observed)
    count = whiten.count(data.shape)
    refuse(
        not is_traced(count) and not count,
        "All of the data are left out: give finite noise for at least one.",
    )
    layout = unknowns.layout
    mean, weight = _priors(layout, priors)
    scale = 1.0 if noise is not None else data_unit(data, observed)
    objective = Objective(
        _checked_model(model), layout, on_host(unknowns.first), on_host(data), whiten,
        on_host(scale), mean, weight, loss_of(loss),
    )  # fmt: skip
    return objective, noise is not None


def _checked_model(model: Any) -> Any:
    if not callable(model):  # the repr of jax arrays is slow
        raise BadInput(f"The model is {model!r}: give a function of the parameters.")
    return model


def _priors(layout, priors) -> tuple[Any, Any]:
    if not priors:
        return None, None
    remedy = "give (mean, standard deviation above 0)"
    refuse(not isinstance(priors, Mapping), f"priors is {priors!r}: {remedy} by name.")
    pairs = flat_mapping(priors)
    for name, pair in pairs.items():
        is_pair = isinstance(pair, list | tuple) and len(pair) == 2
        refuse(not is_pair, f"The prior of {name} is {pair!r}: {remedy}.")
    mean = layout.row_of("The prior's mean", {name: pair[0] for name, pair in pairs.items()}, 0.0)
    stderr = layout.row_of(
        "The prior's standard deviation", {name: pair[1] for name, pair in pairs.items()}, np.inf
    )
    free = np.asarray(layout.free)
    if is_traced(mean, stderr):
        return on_host(mean[free]), on_host(1 / stderr[free])
    wrong = ~np.isfinite(mean) | ~(stderr > 0)
    i = int(np.argmax(wrong))
    refuse(
        bool(wrong.any()),
        f"The prior of {layout.names[i]} is ({mean[i]:g}, {stderr[i]:g}): {remedy}.",
    )
    return on_host(mean[free]), on_host(1 / stderr[free])


def check_linear(objective: Objective, points, linear: Collection[str]) -> None:
    """Refuse a parameter that is declared linear and is not; a model's own declaration is trusted,
    as the test compiles it once more."""
    layout = objective.layout
    said = getattr(objective.model, "linear", ())
    if is_traced(objective, points):
        return
    if not layout.linear or (isinstance(said, tuple) and set(linear) <= set(said)):
        return
    names = ", ".join(layout.names[i] for i in layout.linear[:4])
    if not bool(_is_affine(objective, points[0])):
        refuse(
            True,
            f"The model is not linear in {names}: remove from linear the parameters that "
            "enter nonlinearly or multiply each other.",
        )


@compiled
def _is_affine(objective: Objective, z):
    places = np.array(
        [i for i, at in enumerate(objective.layout.free) if at in objective.layout.linear]
    )
    size = jnp.maximum(jnp.abs(z[places]), 1.0)

    def at(reach):
        return objective.signal(z.at[places].set(reach * size))

    zero, one, two = jax.lax.map(at, jnp.array([0.0, 1.0, 2.5], size.dtype))
    bent = jnp.linalg.norm(two - zero - 2.5 * (one - zero))
    eps = jnp.finfo(size.dtype).eps
    straight = bent <= eps**0.5 * (jnp.linalg.norm(two - zero) + eps**0.5 * jnp.linalg.norm(zero))
    # Where it is not finite the search reports it.
    return straight | ~jnp.isfinite(two).all()
