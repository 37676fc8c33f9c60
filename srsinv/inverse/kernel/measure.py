"""The measured kernel of a sensor: passes over a known input, averaged, and regularised.

The signals are known input times kernel (design.py), the kernel a Gaussian process of the physics'
smoothness (lags.py). Its scale and length are set by the evidence's slopes, its envelope and the
far field's error step by step among a few. About zero it is the kernel that the data alone give
(Howe and Cutkosky 1993, Section IV-B). About a theory whose parameters are fitted with it, it is
what the theory leaves (Kennedy and O'Hagan 2001): where the theory is right the evidence takes the
scale of the rest to zero, else the data determine the kernel.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import BadInput, refuse
from ...forward.sensor import Sensor
from ...grid import Open
from ...numerics import root_of
from ..line.problem import LineProblem
from ..problem import Problem
from .design import KnownInput, stated_effects
from .evidence import KernelEnvelope, KernelPosterior, KernelPrior, Products, likeliest, posterior
from .lags import LEAST_REACH, REACH, Lags
from .measured import MeasuredKernel
from .physics import Physics, default_parameters
from .signals import KernelSignals, Mean, ResidualProducts, far_field, theory

WIDTHS = 0.5, 1.0, 2.0, 4.0  # depths: the envelope's width,
FAR_PARTS = 0.03, 1.0  # what is left of it far from the load,
FARS = 0.1, 1.0  # and of the stated kernel, by which the far field may be off
CHOICES = {"width": WIDTHS, "far_part": FAR_PARTS, "far": FARS}


class Place(NamedTuple):
    """One of each of the choices."""

    width: float = WIDTHS[0]
    far_part: float = FAR_PARTS[0]
    far: float = FARS[0]

    def envelope(self, depth_m: float) -> KernelEnvelope:
        """The envelope at a film's depth."""
        return KernelEnvelope(self.width * depth_m, self.far_part)

    @property
    def neighbours(self) -> list["Place"]:
        """Those one step away."""
        found = []
        for name, choices in CHOICES.items():
            at = choices.index(getattr(self, name))
            for other in (*choices[at + 1 : at + 2], *choices[max(at - 1, 0) : at]):
                found.append(self._replace(**{name: other}))
        return found


class Chosen(NamedTuple):
    """The likeliest prior with its place and evidence, and the products under it, of parameters
    in these `units` (c,)."""

    place: Place
    prior: KernelPrior
    evidence: float
    products: list[Products]
    units: Float[np.ndarray, " c"]


def choose(
    about: Sequence[ResidualProducts],
    first: KernelPrior,
    place: Place,
    t0: Float[np.ndarray, " c"],
    shared: bool,
    is_free: bool = True,
) -> Chosen:
    """The likeliest prior of these elements, from a first one: from place to place as long as a
    neighbour is likelier, or at the first alone where that `is_free` not.

    t is normal about -`t0`, the far fields of all elements its last; `shared`: see `likeliest`.
    """
    signals = about[0].signals
    far_fields = t0.size - 2 * len(signals.elements)

    def at(place: Place, start: KernelPrior) -> Chosen:
        units = np.where(np.arange(t0.size) < far_fields, 1.0, place.far)
        envelope = place.envelope(signals.lags.depth_m)
        own = [each.under(envelope).scaled(units) for each in about]
        start = start._replace(envelope=envelope)
        prior, evidence = likeliest(own, start, signals.k, t0, shared)
        return Chosen(place, prior, evidence, own, units)

    best, tried = at(place, first), {place}
    left = place.neighbours if is_free else []
    while left:
        tried.add(left[0])
        found = at(left[0], best.prior)
        if found.evidence > best.evidence:
            best, left = found, [each for each in found.place.neighbours if each not in tried]
        else:
            left = left[1:]
    return best


# Of the variance of the kernel's slope, to which a rate responds: error directions left out.
NEGLIGIBLE_VARIANCE = 1e-3


class KernelChange(NamedTuple):
    """Kernels (e, 2, m), their factors far away (e, 2), and directions of both (j, ...)."""

    value: Float[np.ndarray, "e 2 m"]
    far: Float[np.ndarray, "e 2"]
    directions: Sequence[tuple[np.ndarray, ...]]

    def plus(self, other: "KernelChange") -> "KernelChange":
        """Both together."""
        directions = [*self.directions, *other.directions]
        return KernelChange(self.value + other.value, self.far + other.far, directions)


def kernel_change(
    signals: KernelSignals,
    found: KernelPosterior,
    prior: KernelPrior,
    mean: Mean,
    elements: Sequence[int],
) -> KernelChange:
    """What the posterior adds to the prior's mean, and the directions of its error."""
    basis = signals.basis(prior.envelope)
    value = np.tensordot(found.t, mean.kernel_slope, 1)
    moves, directions = np.array(mean.kernel_slope), []
    for e, given in zip(elements, found.elements, strict=True):
        value[e] += _at_lags(given.coefficients(found.t)[:, None], basis)[0]
        moves[:, e] += _at_lags(given.slope, basis)
        spread = np.zeros((given.root.shape[0], *mean.kernel.shape))
        spread[:, e] = _at_lags(given.factor, basis)
        directions.append((spread, np.zeros(spread.shape[:-1])))
    root = root_of(found.covariance)
    shared = (np.tensordot(root.T, each, 1) for each in (moves, mean.far_slope))
    far = np.tensordot(found.t, mean.far_slope, 1)
    return KernelChange(value, far, [tuple(shared), *directions])


def change_by_gains(
    signals: KernelSignals, prior: KernelPrior, mean: Mean, elements: Sequence[int]
) -> tuple[Float[np.ndarray, "j e 2 m"], Float[np.ndarray, "j e 2"]]:
    """What gains that vary from pass to pass leave open of these elements' kernels and of their
    factors far away: H (g_j y), with H the map from the signals y to the kernels under this prior,
    and g_j the gains of the means over passes, in independent directions (see `PassGains`)."""
    none = np.zeros_like(mean.kernel), np.zeros_like(mean.far)
    values, fars = [np.zeros((0, *each.shape)) for each in none]
    for gains in signals.gain_errors:
        own = Mean(*none, signals.data * (1 - gains[:, None]), *mean[3:])
        about = signals.less_mean(own)
        products = [about[e].under(prior.envelope) for e in elements]
        found = posterior(products, prior, signals.k, np.zeros(len(mean.far_slope)))
        change = kernel_change(signals, found, prior, own, elements)
        values, fars = (
            np.concatenate([every, each[None]])
            for every, each in ((values, change.value), (fars, change.far))
        )
    return values, fars


def as_kernel(
    signals: KernelSignals,
    change: KernelChange,
    parameters: Mapping[str, tuple[float, float]],
    chi2: float,
    stats: Mapping[str, float],
) -> MeasuredKernel:
    """The kernel, its error in the fewest directions; `chi2` of what it leaves."""
    known = signals.known
    freedom = signals.sample_count - stats["resolved_dof"]
    kept = [strongest(*each) for each in change.directions if len(each[0])]
    factors, far_factors = (np.concatenate(each) for each in zip(*kept, strict=True))
    variance = sum(np.sum(each**2, axis=0) for each, _ in change.directions)
    return MeasuredKernel(
        signals.lags, change.value, np.sqrt(variance), factors, change.far, far_factors, parameters,
        float(known.scan.speed_m_per_s), known.effective_friction, signals.has_both_ways,
        chi2 / max(freedom, 1.0), freedom, stats,
    )  # fmt: skip


def _at_lags(
    coefficients: Float[np.ndarray, "a j"], basis: Float[np.ndarray, "2 b m"]
) -> Float[np.ndarray, "j 2 m"]:
    """Kernels of p and q of the coefficients of their waves."""
    by_component = coefficients.reshape(2, -1, coefficients.shape[1]).swapaxes(1, 2)
    return (by_component @ basis).swapaxes(0, 1)


def strongest(
    kernel: Float[np.ndarray, "j e 2 m"], far: Float[np.ndarray, "j e 2"]
) -> tuple[Float[np.ndarray, "i e 2 m"], Float[np.ndarray, "i e 2"]]:
    """The fewest independent directions of the same error, but for `NEGLIGIBLE_VARIANCE` of the
    variance of the kernel's slope, which is what a rate shows."""
    slope = np.diff(kernel, axis=-1).reshape(len(kernel), -1)
    values, axes = np.linalg.eigh(slope @ slope.T)
    order = np.argsort(values)[::-1]
    left = 1 - np.cumsum(values[order]) / np.sum(values)
    own = axes[:, order[: int(np.argmax(left < NEGLIGIBLE_VARIANCE)) + 1]]
    return np.tensordot(own.T, kernel, 1), np.tensordot(own.T, far, 1)


# Of the theory's largest value: where the search for the scale of the rest starts.
FIRST_REST = 0.03
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
      line (`problem.to_grid().line`); `friction`: mu, with which the shear is q = mu p.
    - `parameters`: names of physical parameters that are fitted, about which the rest is a Gaussian
      process (see physics.py); none: the kernel of the data alone; None: gains, depth, tilt and
      layers.

    Raises `BadInput` for a pressure of another shape or without any change, and a line that is too
    short.
    """
    line_problem = problem.to_grid() if isinstance(problem, Problem) else problem
    known = known_input(line_problem, stated, pressure_Pa, friction)
    names = default_parameters(stated) if parameters is None else parameters
    signals = KernelSignals(known, stated, Lags(float(stated.depth_m), _reach(known)))
    physics = Physics(stated, names)
    return _around_theory(signals, physics) if physics.names else _of_data(signals)


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
        "pressure_Pa is uniform, which gives no rate signal: give an input with a "
        "line, a step or a ridge.",
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
        f"The scan reaches {most:.4g} m beyond the known input, less than the "
        f"kernel's {LEAST_REACH:g} film depths ({LEAST_REACH * depth:.4g} m): scan "
        "further.",
    )
    return min(most, REACH * depth)


def _of_data(signals: KernelSignals) -> MeasuredKernel:
    """The kernel that the data alone give: element by element, as nothing is common to them."""
    mean = far_field(signals)
    none = np.zeros(len(mean.far_slope))
    shared = not signals.has_both_ways  # passes of one way do not tell scales apart
    whole, stats = KernelChange(np.array(mean.kernel), np.array(mean.far), []), {}
    by_gains = []
    evidence = resolved = chi2 = 0.0
    for e, about in zip(signals.elements, signals.less_mean(mean), strict=True):
        best = choose([about], _first_prior(about), Place(), none, shared)
        found = posterior(best.products, best.prior, signals.k, none)
        rows = slice(2 * e, 2 * e + 2)  # of the parameters: the far fields of this element
        part = mean.scaled(best.units).of(rows)
        whole = whole.plus(kernel_change(signals, found.of(rows), best.prior, part, [e]))
        by_gains.append(change_by_gains(signals, best.prior, mean.scaled(best.units), [e]))
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


def _first_prior(about: ResidualProducts) -> KernelPrior:
    """One under which the process would make the data's power, p and q in the ratio of the stated
    kernels."""
    signals = about.signals
    peak = np.abs(signals.stated_kernel[about.element]).max(axis=-1)
    depth = signals.lags.depth_m
    unit = KernelPrior(peak[None], depth, Place().envelope(depth))
    own = about.under(unit.envelope)
    power = float(np.diag(own.waves) @ unit.deviations(0, signals.k) ** 2)
    factor = np.sqrt(own.square / max(power, float(np.finfo(float).tiny)))
    return unit._replace(scale=factor * unit.scale)


def _around_theory(signals: KernelSignals, physics: Physics) -> MeasuredKernel:
    """The kernel about a theory that is fitted with it, linearised in its parameters anew in every
    round."""
    far, depth, unit = far_field(signals), signals.lags.depth_m, physics.deviations
    values, place = physics.stated, Place()
    mean = theory(signals, physics, values).joined_with(far)
    peak = np.abs(mean.kernel).max(axis=-1)
    prior = KernelPrior(FIRST_REST * peak, depth, place.envelope(depth))
    for n in range(MOST_ROUNDS):
        t0 = np.concatenate([(values - physics.stated) / unit, np.zeros(len(far.far_slope))])
        best = choose(signals.less_mean(mean), prior, place, t0, True, n < FREE_ROUNDS)
        prior, place = best.prior, best.place
        found = posterior(best.products, prior, signals.k, t0)
        errors = np.sqrt(np.diag(found.covariance))[: unit.size]
        if np.all(np.abs(found.t[: unit.size]) <= SETTLED * errors):
            break
        values = physics.within(values + unit * found.t[: unit.size])
        mean = theory(signals, physics, values).joined_with(far)
    t0 = np.concatenate([(values - physics.stated) / unit, np.zeros(len(far.far_slope))])
    best = choose(signals.less_mean(mean), prior, place, t0, not signals.has_both_ways)
    prior, mean = best.prior, mean.scaled(best.units)
    found = posterior(best.products, prior, signals.k, t0)
    by_gains = change_by_gains(signals, prior, mean, signals.elements)
    whole = KernelChange(mean.kernel, mean.far, [by_gains]).plus(
        kernel_change(signals, found, prior, mean, signals.elements)
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
    signals: KernelSignals, prior: KernelPrior, slopes: Float[np.ndarray, "c e 2 m"]
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
