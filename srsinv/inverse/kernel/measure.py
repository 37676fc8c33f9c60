"""The measured kernel of a sensor: passes over a known input, averaged, and regularised.

The signals are known input times kernel (design.py), the kernel a Gaussian process of the physics'
smoothness (lags.py) whose scale, length and envelope the evidence sets (evidence.py). About zero it
is the kernel that the data alone give (Howe and Cutkosky 1993, Section IV-B). About a theory
whose parameters are fitted with it, it is what the theory leaves (Kennedy and O'Hagan 2001): where
the theory is right the evidence takes the scale of the rest to nothing, else the data have the
word.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import BadInput, refuse
from ...forward.sensor import Sensor
from ...grid import Open
from ..line_problem import LineProblem
from ..problem import Problem
from .answer import Moved, as_kernel, moved
from .design import KnownInput, stated_effects
from .evidence import Envelope, Prior, Products, likeliest, posterior
from .lags import LEAST_REACH, REACH, Lags
from .means import far_field, theory
from .measured import MeasuredKernel
from .physics import Physics, default_parameters
from .signals import KernelSignals

FIRST_REST = (
    0.03  # of the theory's largest value: where the search for the scale of the rest starts
)
MOST_ROUNDS = 6
FARS = 0.1, 1.0  # of the stated kernel, by which the far field may be off: the evidence chooses
ONWARDS = 12  # evaluations for each number of the prior, where a like one is known
SETTLED = 0.05  # standard errors by which a round moves the parameters at most


def measure_kernel(
    problem: Problem | LineProblem,
    stated: Sensor,
    pressure_Pa: Float[np.ndarray, " n"],
    friction: float,
    parameters: Sequence[str] | None = (),
) -> MeasuredKernel:
    """The kernel of a sensor from its signals over a known input.

    - `problem`: the signals; of a motion that turns, the passes of each way are averaged.
    - `stated`: the sensor as it is stated, which gives the depth's scale, the far field beyond the
      measured lags and the theory.
    - `pressure_Pa` (n,): the pressure's deviation from that far away on the cells of the problem's
      line (`problem.on_line().line`); `friction`: mu, with which the shear is q = mu p.
    - `parameters`: names of physical parameters that are fitted, about which the rest is a Gaussian
      process (see physics.py); none: the kernel of the data alone; None: gains, depth, tilt and
      layers.

    Raises `BadInput` for a pressure of another shape or without any change, and a line that is too
    short.
    """
    line_problem = problem.on_line() if isinstance(problem, Problem) else problem
    known = known_input(line_problem, stated, pressure_Pa, friction)
    names = default_parameters(stated) if parameters is None else parameters
    signals = KernelSignals(known, stated, Lags(float(stated.depth_m), _reach(known)))
    physics = Physics(stated, names)
    return _about(signals, physics) if physics.names else _of_data(signals)


def known_input(
    problem: LineProblem, stated: Sensor, pressure_Pa: Float[np.ndarray, " n"], friction: float
) -> KnownInput:
    """The signals over a known input, checked."""
    if problem.sensor is None or problem.scan is None:
        raise BadInput("A kernel is measured of a sensor along a scan: give sensor and scan.")
    pressure = np.asarray(pressure_Pa, float)
    refuse(
        pressure.shape != (problem.line.n,) or not np.isfinite(pressure).all(),
        f"pressure_Pa has the shape {pressure.shape}: give a number for each of the "
        f"{problem.line.n} cells of the problem's line.",
    )
    refuse(
        not np.ptp(pressure) > 0,
        "pressure_Pa is the same in all cells, to which a rate has no response: give an input with "
        "a line, a step or a ridge.",
    )
    films = stated_effects(problem.sensor.elements, stated.elements)
    return KnownInput(problem, problem.sensor, problem.scan, pressure, float(friction), films)


def _reach(known: KnownInput) -> float:
    """How far the kernel is measured: as far as the scan goes on both sides of the input."""
    line, depth = known.problem.line, float(known.sensor.depth_m)
    if isinstance(line, Open):
        x, slope = np.asarray(line.x), np.abs(np.diff(known.pressure_Pa, append=0.0))
        middle = float(np.sum(x * slope) / np.sum(slope))
        scanned = x[known.problem.observed_cells]
        most = max(middle - float(scanned.min()), float(scanned.max()) - middle)
    else:
        most = line.n * float(line.cell_m) / 2
    refuse(
        most < LEAST_REACH * depth,
        f"The scan goes {most:.4g} m beyond the known input, less than {LEAST_REACH:g} depths of "
        f"the film ({LEAST_REACH * depth:.4g} m): scan further, as the kernel is that long.",
    )
    return min(most, REACH * depth)


def _of_data(signals: KernelSignals) -> MeasuredKernel:
    """The kernel that the data alone give: element by element, as nothing is common to them."""
    mean, depth = far_field(signals), signals.lags.depth_m
    none = np.zeros(len(mean.far_slope))
    products = {each: signals.products(each, mean) for each in Envelope.all_of(depth)}
    whole, stats = Moved(np.array(mean.kernel), np.array(mean.far), []), {}
    evidence = resolved = 0.0
    for e in signals.elements:
        first = next(iter(products))
        prior = Prior(_first_scale(signals, products[first][e], e), depth, first)
        own = {envelope: [each[e]] for envelope, each in products.items()}
        best = max(
            (_best_envelope(signals, own, prior, none, far) for far in FARS),
            key=lambda each: each.evidence,
        )
        found = posterior(best.products, best.prior, signals.k, none)
        rows = slice(2 * e, 2 * e + 2)  # of the parameters: the far fields of this element
        part = mean.scaled(best.units).of(rows)
        whole = whole.plus(moved(signals, found.of(rows), best.prior, part, [e]))
        stats |= {f"length_{e + 1}_m": best.prior.length_m}
        stats |= {f"envelope_{e + 1}_m": best.prior.envelope.width_m}
        evidence += found.log_evidence
        resolved += found.resolved_dof
    stats |= {"log_evidence": evidence, "resolved_dof": resolved}
    return as_kernel(signals, whole, {}, stats)


def _first_scale(signals: KernelSignals, own: Products, element: int) -> Float[np.ndarray, "1 2"]:
    """Scales under which the process would make the data's power, in the ratio of the stated
    kernels: passes of one way do not tell it."""
    peak = np.abs(signals.stated_kernel[element]).max(axis=-1)
    depth = signals.lags.depth_m
    unit = Prior(peak[None], depth, Envelope(depth, 1.0)).deviations(0, signals.k)
    power = float(np.diag(own.waves) @ unit**2)
    return peak[None] * np.sqrt(own.square / max(power, float(np.finfo(float).tiny)))


class _Best(NamedTuple):
    """The likeliest prior with its evidence, and the products under it, of parameters in these
    `units` (c,)."""

    evidence: float
    prior: Prior
    products: list[Products]
    units: Float[np.ndarray, " c"]


def _best_envelope(
    signals: KernelSignals,
    products: Mapping[Envelope, list[Products]],
    first: Prior,
    t0: Float[np.ndarray, " c"],
    far: float,
    shared: bool | None = None,
) -> _Best:
    """The likeliest prior over these envelopes, the far fields off by `far`.

    `shared`: see `likeliest`; None: where passes of one way do not tell scales apart.
    """
    shared = not signals.has_both_ways if shared is None else shared
    units, steps = np.ones(t0.size), None
    units[t0.size - 2 * len(signals.elements) :] = far
    tried = []
    for envelope, each in products.items():
        own = [one.scaled(units) for one in each]
        start = first._replace(envelope=envelope)
        first, evidence = likeliest(own, start, signals.k, t0, shared, steps)
        tried.append(_Best(evidence, first, own, units))
        steps = ONWARDS
    return max(tried, key=lambda each: each.evidence)


def _about(signals: KernelSignals, physics: Physics) -> MeasuredKernel:
    """The kernel about a theory that is fitted with it, linearised in its parameters anew in every
    round."""
    far, depth, unit = far_field(signals), signals.lags.depth_m, physics.deviations
    values, envelopes = physics.stated, Envelope.all_of(depth)
    mean = theory(signals, physics, values).beside(far)
    peak = np.abs(mean.kernel).max(axis=-1)
    prior = Prior(FIRST_REST * peak, depth, envelopes[0])
    for _ in range(MOST_ROUNDS):
        t0 = np.concatenate([(values - physics.stated) / unit, np.zeros(len(far.far_slope))])
        products = {each: signals.products(each, mean) for each in envelopes}
        best = _best_envelope(signals, products, prior, t0, FARS[0], True)
        prior, envelopes = best.prior, [best.prior.envelope]
        found = posterior(best.products, prior, signals.k, t0)
        errors = np.sqrt(np.diag(found.covariance))[: unit.size]
        if np.all(np.abs(found.t[: unit.size]) <= SETTLED * errors):
            break
        values = physics.within(values + unit * found.t[: unit.size])
        mean = theory(signals, physics, values).beside(far)
    t0 = np.concatenate([(values - physics.stated) / unit, np.zeros(len(far.far_slope))])
    products = {each: signals.products(each, mean) for each in Envelope.all_of(depth)}
    best = max(
        (_best_envelope(signals, products, prior, t0, each) for each in FARS),
        key=lambda each: each.evidence,
    )
    prior, mean = best.prior, mean.scaled(best.units)
    found = posterior(best.products, prior, signals.k, t0)
    whole = Moved(mean.kernel, mean.far, []).plus(
        moved(signals, found, prior, mean, signals.elements)
    )
    errors = np.sqrt(np.diag(found.covariance))[: unit.size]
    at = values + unit * found.t[: unit.size]
    pairs = zip(at.tolist(), (unit * errors).tolist(), strict=True)
    stats = {
        "rest_over_theory": float(np.max(prior.scale / np.abs(mean.kernel).max(axis=-1))),
        "length_m": prior.length_m,
        "envelope_m": prior.envelope.width_m,
        "log_evidence": found.log_evidence,
        "resolved_dof": found.resolved_dof,
    }
    return as_kernel(signals, whole, dict(zip(physics.names, pairs, strict=True)), stats)
