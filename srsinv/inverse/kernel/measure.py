"""The measured kernel of a sensor: passes over a known input, averaged, and regularised.

The signals are known input times kernel (design.py), the kernel a Gaussian process of the physics'
smoothness (lags.py) whose scale, length and envelope the evidence sets (choice.py). About zero it
is the kernel that the data alone give (Howe and Cutkosky 1993, Section IV-B). About a theory
whose parameters are fitted with it, it is what the theory leaves (Kennedy and O'Hagan 2001): where
the theory is right the evidence takes the scale of the rest to nothing, else the data have the
word.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...errors import BadInput, refuse
from ...forward.sensor import Sensor
from ...grid import Open
from ..line_problem import LineProblem
from ..problem import Problem
from .answer import Moved, as_kernel, moved, moved_by_gains
from .choice import Place, choose
from .design import KnownInput, stated_effects
from .evidence import Prior, posterior
from .lags import LEAST_REACH, REACH, Lags
from .means import far_field, theory
from .measured import MeasuredKernel
from .physics import Physics, default_parameters
from .signals import About, KernelSignals

FIRST_REST = (
    0.03  # of the theory's largest value: where the search for the scale of the rest starts
)
MOST_ROUNDS = 10
FREE_ROUNDS = 2  # in which the envelope is sought, as two may take turns
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
    mean = far_field(signals)
    none = np.zeros(len(mean.far_slope))
    shared = not signals.has_both_ways  # passes of one way do not tell scales apart
    whole, stats = Moved(np.array(mean.kernel), np.array(mean.far), []), {}
    by_gains = []
    evidence = resolved = chi2 = 0.0
    for e, about in zip(signals.elements, signals.about(mean), strict=True):
        best = choose([about], _first_prior(about), Place(), none, shared)
        found = posterior(best.products, best.prior, signals.k, none)
        rows = slice(2 * e, 2 * e + 2)  # of the parameters: the far fields of this element
        part = mean.scaled(best.units).of(rows)
        whole = whole.plus(moved(signals, found.of(rows), best.prior, part, [e]))
        by_gains.append(moved_by_gains(signals, best.prior, mean.scaled(best.units), [e]))
        stats |= {f"length_{e + 1}_m": best.prior.length_m}
        stats |= {f"envelope_{e + 1}_m": best.prior.envelope.width_m}
        evidence += found.log_evidence
        resolved += found.resolved_dof
        chi2 += found.chi2(best.products)
    stats |= {"log_evidence": evidence, "resolved_dof": resolved}
    # A pass's gain is of all elements: what each adds to a direction is one direction.
    together = tuple(np.sum(part, axis=0) for part in zip(*by_gains, strict=True))
    whole = whole._replace(directions=[*whole.directions, together])
    return as_kernel(signals, whole, {}, chi2, stats)


def _first_prior(about: About) -> Prior:
    """One under which the process would make the data's power, p and q in the ratio of the stated
    kernels."""
    signals = about.signals
    peak = np.abs(signals.stated_kernel[about.element]).max(axis=-1)
    depth = signals.lags.depth_m
    unit = Prior(peak[None], depth, Place().envelope(depth))
    own = about.under(unit.envelope)
    power = float(np.diag(own.waves) @ unit.deviations(0, signals.k) ** 2)
    factor = np.sqrt(own.square / max(power, float(np.finfo(float).tiny)))
    return unit._replace(scale=factor * unit.scale)


def _about(signals: KernelSignals, physics: Physics) -> MeasuredKernel:
    """The kernel about a theory that is fitted with it, linearised in its parameters anew in every
    round."""
    far, depth, unit = far_field(signals), signals.lags.depth_m, physics.deviations
    values, place = physics.stated, Place()
    mean = theory(signals, physics, values).beside(far)
    peak = np.abs(mean.kernel).max(axis=-1)
    prior = Prior(FIRST_REST * peak, depth, place.envelope(depth))
    for n in range(MOST_ROUNDS):
        t0 = np.concatenate([(values - physics.stated) / unit, np.zeros(len(far.far_slope))])
        best = choose(signals.about(mean), prior, place, t0, True, n < FREE_ROUNDS)
        prior, place = best.prior, best.place
        found = posterior(best.products, prior, signals.k, t0)
        errors = np.sqrt(np.diag(found.covariance))[: unit.size]
        if np.all(np.abs(found.t[: unit.size]) <= SETTLED * errors):
            break
        values = physics.within(values + unit * found.t[: unit.size])
        mean = theory(signals, physics, values).beside(far)
    t0 = np.concatenate([(values - physics.stated) / unit, np.zeros(len(far.far_slope))])
    best = choose(signals.about(mean), prior, place, t0, not signals.has_both_ways)
    prior, mean = best.prior, mean.scaled(best.units)
    found = posterior(best.products, prior, signals.k, t0)
    by_gains = moved_by_gains(signals, prior, mean, signals.elements)
    whole = Moved(mean.kernel, mean.far, [by_gains]).plus(
        moved(signals, found, prior, mean, signals.elements)
    )
    errors = np.sqrt(np.diag(found.covariance))[: unit.size]
    errors = np.hypot(errors, _moves_by_rest(signals, prior, mean.kernel_slope[: unit.size]))
    at = values + unit * found.t[: unit.size]
    pairs = zip(at.tolist(), (unit * errors).tolist(), strict=True)
    stats = {
        "rest_over_theory": float(np.max(prior.scale / np.abs(mean.kernel).max(axis=-1))),
        "length_m": prior.length_m,
        "envelope_m": prior.envelope.width_m,
        "log_evidence": found.log_evidence,
        "resolved_dof": found.resolved_dof,
    }
    fitted = dict(zip(physics.names, pairs, strict=True))
    return as_kernel(signals, whole, fitted, found.chi2(best.products), stats)


def _moves_by_rest(
    signals: KernelSignals, prior: Prior, slopes: Float[np.ndarray, "c e 2 m"]
) -> Float[np.ndarray, " c"]:
    """By how much parameters t, of these slopes of the kernels, are off where all of a rest under
    this prior looks like a change of theirs.

    The process takes waves and kernels as independent. What a theory misses, as an average over a
    wider strip, is common to all kernels and may look like another depth.
    """
    squares = np.sum(signals.basis(prior.envelope) ** 2, axis=-1).ravel()
    power = sum(prior.deviations(e, signals.k) ** 2 @ squares for e in range(len(prior.scale)))
    rows = slopes.reshape(len(slopes), -1)
    return np.sqrt(power * np.diag(np.linalg.pinv(rows @ rows.T)))
