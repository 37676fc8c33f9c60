"""Samples of the posterior of a nonlinear fit, or of any density: `srsinv.sample`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
import scipy
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import number, refuse, whole
from ...grid import as_real
from ._answer import Fit
from ._parameters import Layout, Tree, on_host, parameters
from ._posterior import Box, FitDensity, FreeDensity, OwnDensity, root_of
from ._sampler import check_sampler, sampled
from ._samples import PosteriorSamples
from ._uncertainty import Spread, spread

LEAST_DRAWS, LEAST_WARMUP = 50, 100  # of a chain: halves of fewer have no variance to compare
WIDER = 1.1  # of standard errors: what a fit's contain beside the noise is stated beyond it
MODE_ROUNDS = 3  # of a search for a mode, each in the scale of the last curvature
AT_MODE = 0.1  # slope at a mode, per standard deviation
BESIDE = 1e-3  # of a first value on a bound: how far inside it the search for a mode begins


@dataclass(frozen=True)
class FitToSample:
    """A fit, and what its parameters are reported as.

    - `read`: from a tree of parameters to the reported values by name; None: the fitted ones.
    - `report`: from the fit to reported values and standard errors by name.
    - `warnings`: those on what is reported, beside the fit's own.
    """

    fit: Fit
    read: Callable[[Tree], Mapping[str, float]] | None = None
    report: Callable[[Fit], Mapping[str, tuple[float, float]]] | None = None
    warnings: tuple[str, ...] = ()


def sample(
    target: Any,
    *,
    initial: Tree = None,
    bounds: Any = None,
    draws: int = 1000,
    chains: int = 4,
    warmup: int = 500,
    acceptance: float = 0.8,
    seed: int = 0,
) -> PosteriorSamples:
    """Draw samples from a posterior with the No-U-Turn sampler of blackjax.

    Returns [`PosteriorSamples`][srsinv.PosteriorSamples]. Arguments:

    - `target`: a [`Fit`][srsinv.Fit]; a [`FeatureEstimate`][srsinv.FeatureEstimate]; or a function
      from a tree of parameters to the log of a density, up to a constant.
    - `initial`: the parameters of a function, as of [`fit`][srsinv.fit], from where its mode is
      searched; None for a fit.
    - `bounds`: those of a function's parameters, `{name: (lower, upper)}`; a fit has its own.
    - `draws`: number of draws that are kept of each chain, after `warmup` others that adapt step
      and metric. `chains`: number of chains.
    - `acceptance`: rate of acceptance that the step aims at; a larger one takes shorter steps.
    - `seed`: of the random numbers; the same one gives the same draws.

    The posterior of a fit is its likelihood times its Gaussian `priors`; the prior of any other
    parameter is flat within its bounds. A noise level that was not given has the prior 1/sigma and
    is integrated out, which makes the likelihood Student's. Parameters keep to their bounds by
    smooth transforms. Chains start about the mode, in the scale of Laplace's approximation.

    Raises `BadInput` for a fit that did not converge, and for parameters that neither the data nor
    priors or bounds on both sides limit. Needs the extra `sample`.
    """
    draws = whole("draws", draws, f"a whole number from {LEAST_DRAWS}", least=LEAST_DRAWS)
    chains = whole("chains", chains, "a whole number from 2", least=2)
    warmup = whole("warmup", warmup, f"a whole number from {LEAST_WARMUP}", least=LEAST_WARMUP)
    seed = whole("seed", seed, "a whole number from 0", least=0)
    number("acceptance", acceptance, "a number between 0 and 1", above=0.0, below=1.0)
    of = target.to_sample() if hasattr(target, "to_sample") else target
    of = FitToSample(of) if isinstance(of, Fit) else of
    is_fit = isinstance(of, FitToSample)
    refuse(
        not is_fit and (not callable(target) or initial is None),
        f"The target is a {type(target).__name__}: give a fit, a fit of features, or a function of "
        "the parameters with initial.",
    )
    refuse(
        is_fit and (initial is not None or bounds is not None),
        "A fit has its own parameters and bounds: leave out initial and bounds.",
    )
    check_sampler()
    how = draws, chains, warmup, float(acceptance), seed
    return _of_fit(of, *how) if is_fit else _of_function(target, initial, bounds, *how)


def _of_fit(target: FitToSample, *how: Any) -> PosteriorSamples:
    fit = target.fit
    objective, search, m = fit._objective, fit._search, len(fit.names)
    refuse(
        not fit.converged,
        f"The fit is {fit.status}, so its samples have no start: fit again until it converges.",
    )
    count = None if fit.noise_rms is None else np.asarray(float(fit.stats["data"]))
    refuse(
        count is not None and objective.is_robust,
        "A robust loss has no likelihood without the noise's level: give the fit its noise.",
    )
    refuse(
        count is not None and float(count) <= m,
        f"{m} parameters of {fit.stats['data']} data leave no posterior of the noise's level: "
        "give the fit its noise.",
    )
    rows = fit.whitened_rows()
    eps = float(np.finfo(np.asarray(objective.row).dtype).eps)
    box = Box(as_real(search.lower), as_real(search.upper))
    _check_proper(rows, box, fit.names, eps)
    own = fit._plain
    centre, root = _scaled(fit._z, rows, own, box)
    density = FreeDensity(FitDensity(objective, count), box, as_real(centre), as_real(root))
    made = sampled(density.differentiable(), *how)
    plain = replace(fit, _spread=own, _narrower=None)
    layout, row = objective.layout, np.asarray(objective.row, float)
    trees = _trees(layout, row, made.z)
    if target.read is None or target.report is None:
        names, values = fit.names, made.z
        normal = dict(zip(names, zip(fit._z, own.stderr(), strict=True), strict=True))
    else:
        normal = dict(target.report(plain))
        names, values = tuple(normal), _read(target.read, layout, row, made.z, tuple(normal))
    inherited = (*replace(fit, at_bound=(), undetermined=()).warnings, *target.warnings)
    return PosteriorSamples(
        names, values, trees, normal, made, np.asarray(objective.y), how[2],
        (*inherited, *_widened(fit, plain)),
        None if fit.is_widened else fit.known_chi2, float(fit.stats["degrees_of_freedom"]),
    )  # fmt: skip


def _check_proper(rows: np.ndarray, box: Box, names: tuple[str, ...], eps: float) -> None:
    """Refuse parameters that can go to infinity at a constant density."""
    closed = np.isfinite(np.asarray(box.lower)) & np.isfinite(np.asarray(box.upper))
    open_ended = np.flatnonzero(~closed)
    if not open_ended.size:
        return
    left = spread(rows[:, open_ended], eps).null
    touched = np.abs(left).max(axis=1, initial=0.0) > 1e-6
    which = ", ".join(names[i] for i in open_ended[touched])
    refuse(
        bool(touched.any()),
        f"Neither data nor priors limit {which}, so there is no posterior to sample: give the fit "
        "priors or bounds on both sides.",
    )


def _scaled(
    z: np.ndarray, rows: np.ndarray, own: Spread, box: Box
) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale of the free variables, from the linearised problem."""
    inside = box.away(z, own.stderr())
    centre = box.free(inside)
    slope = np.exp(np.asarray(box.inside(as_real(centre))[1], float))
    width = np.asarray(box.upper, float) - np.asarray(box.lower, float)
    # What a flat prior between two bounds has of curvature in the logistic variable.
    flat = 2 * slope / width
    precision = (rows * slope).T @ (rows * slope) + np.diag(flat)
    return centre, root_of(precision)


def _widened(fit: Fit, plain: Fit) -> tuple[str, ...]:
    """A warning where a fit's standard errors contain more than the noise."""
    with np.errstate(all="ignore"):
        times = np.sqrt(np.diag(fit.covariance) / np.diag(plain.covariance))
    times = times[np.isfinite(times)]
    if fit._objective.is_robust or not times.size or times.max() <= WIDER:
        return ()
    return (
        f"The fit's standard errors are up to {times.max():.3g} times those of noise and priors: "
        "they include a misfit or errors of the model, which the samples leave out. Quote the "
        "fit's standard errors.",
    )


def _trees(layout: Layout, row: np.ndarray, z: Float[np.ndarray, "chain draw m"]) -> Tree:
    """The parameters' tree, each leaf with leading axes (chain, draw)."""
    whole_rows = np.broadcast_to(row, (*z.shape[:2], row.size)).copy()
    whole_rows[..., list(layout.free)] = z
    sizes = [int(np.prod(shape)) for shape in layout.shapes]
    parts = np.split(whole_rows, np.cumsum(sizes)[:-1], axis=-1)
    leaves = [
        part.reshape(*z.shape[:2], *shape) for part, shape in zip(parts, layout.shapes, strict=True)
    ]
    return jax.tree.unflatten(layout.structure, leaves)


def _read(
    read: Callable[[Tree], Mapping[str, float]],
    layout: Layout,
    row: np.ndarray,
    z: Float[np.ndarray, "chain draw m"],
    names: tuple[str, ...],
) -> Float[np.ndarray, "chain draw reported"]:
    """The reported values of each draw."""
    values, filled = [], np.array(row)
    for own in z.reshape(-1, z.shape[-1]):
        filled[list(layout.free)] = own
        reported = read(layout.host_tree(filled))
        values.append([reported[name] for name in names])
    return np.array(values, float).reshape(*z.shape[:2], len(names))


def _of_function(
    function: Callable[[Any], Any], initial: Tree, bounds: Any, *how: Any
) -> PosteriorSamples:
    unknowns = parameters(initial, bounds, None, ())
    layout, box = unknowns.layout, Box(as_real(unknowns.lower), as_real(unknowns.upper))
    beside = np.where(unknowns.first == 0, 1.0, np.abs(unknowns.first)) * BESIDE
    centre = box.free(box.away(unknowns.first, beside))
    of = OwnDensity(function, layout, on_host(unknowns.first))
    unit = np.eye(len(centre))
    density = FreeDensity(of, box, as_real(centre), as_real(unit))
    height = float(_value_and_slope(density, as_real(0 * centre))[0])
    refuse(
        not np.isfinite(height),
        f"The log density is {height} at initial: start where it is finite.",
    )
    at_mode, is_mode = _mode(density)
    made = sampled(at_mode if is_mode else density, *how)
    normal: dict[str, tuple[float, float]] = {}
    if is_mode:
        value, log_slope = (np.asarray(each, float) for each in box.inside(at_mode.centre))
        root = np.asarray(at_mode.root, float)
        stderr = np.exp(log_slope) * np.linalg.norm(root, axis=1)
        normal = dict(zip(layout.names, zip(value, stderr, strict=True), strict=True))
    trees = _trees(layout, np.asarray(unknowns.first, float), made.z)
    return PosteriorSamples(layout.names, made.z, trees, normal, made, None, how[2])


def _mode(density: FreeDensity) -> tuple[FreeDensity, bool]:
    """The density about its mode and in its curvature's scale, and whether there is a mode."""

    def fall(u: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = (np.asarray(each, float) for each in _value_and_slope(density, as_real(u)))
        is_finite = np.isfinite(value) and np.isfinite(slope).all()
        return (-float(value), -slope) if is_finite else (np.inf, np.zeros_like(slope))

    slope = np.full(len(density.centre), np.inf)
    for _ in range(MODE_ROUNDS):
        u = scipy.optimize.minimize(fall, np.zeros(slope.size), jac=True, method="BFGS").x
        curvature = -np.asarray(_hessian(density, as_real(u)), float)
        if not (np.isfinite(u).all() and np.isfinite(curvature).all()):
            return density, False
        slope, root = fall(u)[1], root_of(curvature)
        centre = np.asarray(density.centre) + np.asarray(density.root) @ u
        density = replace(
            density, centre=as_real(centre), root=as_real(np.asarray(density.root) @ root)
        )
        if np.linalg.norm(root.T @ slope) <= AT_MODE * np.sqrt(slope.size):
            return density, bool(np.linalg.eigvalsh(curvature)[0] > 0)
    return density, False


@compiled
def _value_and_slope(density: FreeDensity, u: Float[Array, " m"]) -> tuple[Array, Array]:
    return jax.value_and_grad(density)(u)


@compiled
def _hessian(density: FreeDensity, u: Float[Array, " m"]) -> Float[Array, "m m"]:
    return jax.hessian(density)(u)
