"""The Wiener filter, the paper's (15): noise and traction spectra given."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, overload

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import choice, number, of_kind, refuse
from ..forward.noise import exponential_spectrum
from ..grid import Line, as_real, half_spectrum_weights
from ..known import array_module, as_number, by_numpy, is_traced, namespace
from ..status import Status
from .diagnostics import undetermined_weights
from .estimate import Estimate, Numbers, TractionEstimate
from .line.constrained import constrained
from .line.constraint import Constraint, checked_constraint, refuse_constraint
from .line.prior import Prior
from .line.problem import LineProblem
from .line.rule import Evidence, to_score
from .line.scorer import Family, LineScorer
from .line.solve import PATHS, conditioned, solve
from .linear.estimate import LinearEstimate
from .linear.problem import LinearProblem
from .linear.solve import Regularisation
from .linear.solve import solve as solve_linear
from .method import Method
from .problem import Problem


class TractionSpectrum(eqx.Module):
    """Base of traction spectra: the power per cell [Pa^2] of one component at a line's wavenumbers.

    `power` is to be defined.
    """

    @abc.abstractmethod
    def power(self, problem: LineProblem) -> Float[Any, " k"]:
        """S at the line's wavenumbers."""


def _positive(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"method {name}", value, "a positive number", above=0))


class Exponential(TractionSpectrum):
    """Traction of `rms_Pa`, correlated as exp(-|dx|/correlation_m)."""

    rms_Pa: Float[Array, ""]
    correlation_m: Float[Array, ""]

    def __init__(self, rms_Pa=1500.0, correlation_m=2e-3):
        self.rms_Pa = _positive("rms_Pa", rms_Pa)
        self.correlation_m = _positive("correlation_m", correlation_m)

    def power(self, problem: LineProblem) -> Float[Any, " k"]:
        line = problem.line
        return self.rms_Pa**2 * exponential_spectrum(line.k, line.cell_m, self.correlation_m)


class Flat(TractionSpectrum):
    """White traction of `rms_Pa` per cell."""

    rms_Pa: Float[Array, ""]

    def __init__(self, rms_Pa=1.0):
        self.rms_Pa = _positive("rms_Pa", rms_Pa)

    def power(self, problem: LineProblem) -> Float[Any, " k"]:
        k = problem.line.k
        return namespace(k).full(k.shape, self.rms_Pa**2)


class Normalised(TractionSpectrum):
    """The paper's form: S = 1 in units in which the sensor's largest gain is 1.

    `noise_to_signal` is then the noise's power, so that the filter reads G* / (|G|^2 + N).
    """

    noise_to_signal: Float[Array, ""]

    def __init__(self, noise_to_signal=1e-4):
        self.noise_to_signal = _positive("noise_to_signal", noise_to_signal)

    def power(self, problem: LineProblem) -> Float[Any, " k"]:
        xp = namespace(problem)
        gain = xp.max(xp.abs(problem.forward.circulant().transfer)) ** 2
        last = problem.noise[:, -1:]
        finite = xp.where(xp.isfinite(problem.noise), problem.noise, last)
        level = xp.mean(finite) / (self.noise_to_signal * gain)
        return xp.full(problem.line.k.shape, level)


class SpectralPrior(Prior):
    """P = S^-1 on the line taken as periodic over its window."""

    power: Float[Any, "c k"]

    def root(self, line: Line) -> Float[Any, "c k"]:
        return 1 / namespace(self.power).sqrt(self.power)

    def apply(self, line: Line, r: Float[Any, "c n"]) -> Float[Any, "c n"]:
        # By its root, as the derivative of 1/S is 1/S^2, which overflows long before S does.
        xp = namespace(self.power, r)
        return xp.fft.irfft(xp.fft.rfft(r) * self.root(line) ** 2, line.n)


class ScaledSpectra(Family):
    """Given spectra, each multiplied by a factor."""

    sign: ClassVar[int] = -1
    power: Float[Any, "c k"]

    def __call__(self, log_weights: Float[Numbers, " c"]) -> SpectralPrior:
        xp = namespace(log_weights, self.power)
        return SpectralPrior(10.0 ** xp.asarray(log_weights)[:, None] * self.power)


class Wiener(Method):
    """Wiener's filter: the posterior mean of p and q under Gaussian priors of stated spectra.

    It solves (G^H N^-1 G + S^-1)^-1 G^H N^-1 m: m the signal, N the noise's power, S the spectra.

    - `p`, `q`: their spectra, as `srsinv.inverse.wiener.Exponential(rms_Pa, correlation_m)`, the
      default with 1500 Pa and 2 mm; p and q are taken as independent.
    - `scale`: "given" takes their levels as they are; "evidence" multiplies each by the number
      under which the data are most likely.
    - `path`, `tolerance`: see [`solve`][srsinv.inverse.line.solve.solve].
    - `constraint`: what is known beside the spectra, as `srsinv.Admissible()`, with which p and q
      are the most probable admissible ones. None: nothing.

    Of a [`LinearProblem`][srsinv.LinearProblem] it takes the prior that the problem has; "evidence"
    multiplies the prior's covariance by 1 / `weight` of the stats.

    Raises `BadInput` for other values, and for a `LinearProblem` without a prior.
    """

    p: TractionSpectrum
    q: TractionSpectrum
    scale: str = eqx.field(static=True)
    path: str = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)
    constraint: Constraint

    def __init__(
        self,
        p: Any = None,
        q: Any = None,
        scale: Any = "given",
        path: Any = "auto",
        tolerance: Any = 1e-10,
        constraint: Any = None,
    ):
        self.p, self.q = _spectrum("p", p), _spectrum("q", q)
        self.scale = choice("method.wiener.scale", scale, ("given", "evidence"))
        self.path = choice("method.wiener.path", path, PATHS)
        key, wanted = "method.wiener.tolerance", "a positive number below 1"
        self.tolerance = number(key, tolerance, wanted, above=0, below=1)
        self.constraint = checked_constraint("method.wiener.constraint", constraint)

    @overload
    def __call__(self, problem: LinearProblem) -> LinearEstimate: ...
    @overload
    def __call__(self, problem: Problem | LineProblem) -> Estimate: ...
    def __call__(self, problem: Problem | LineProblem | LinearProblem) -> Estimate | LinearEstimate:
        """Posterior mean and standard error of p and q, or of a linear problem's unknown."""
        if isinstance(problem, LinearProblem):
            return self._linear(problem)
        problem = problem.to_grid()
        power = self.spectra(problem)
        if self.scale == "given":
            return self._solved(problem, power, Status.GIVEN)
        scale, status = _likely_scale(problem, power, self.path)
        xp = array_module(scale, power)
        scaled = xp.asarray(scale)[:, None] * xp.asarray(power)
        return conditioned(
            lambda decades: self._solved(problem, as_real(scaled / 10**decades), status)
        )

    def _linear(self, problem: LinearProblem) -> LinearEstimate:
        """The posterior of a linear problem under its prior."""
        refuse_constraint(self.constraint)
        refuse(
            problem.prior is None,
            "Wiener needs a prior, which the LinearProblem lacks: give it "
            "prior=srsinv.GaussianPrior(...), or take srsinv.Tikhonov().",
        )
        weight = 1.0 if self.scale == "given" else None
        stats = {"method": "wiener", "scale": self.scale}
        how = self.path, self.tolerance, stats
        return solve_linear(problem, Regularisation(weight, Evidence(), 0, *how))

    def _solved(
        self, problem: LineProblem, power: Float[Array, "c k"], status: Status
    ) -> TractionEstimate:
        """The estimate of these spectra."""
        stats: dict = {"method": "wiener", "scale": self.scale}
        if self.scale == "evidence":
            stats["scale_rule"] = status
        stats |= {
            f"rms_{c}_Pa": as_number((half_spectrum_weights(problem.line.n) @ s) ** 0.5)
            for c, s in zip("pq", power if is_traced(power) else np.asarray(power), strict=False)
        }
        how, warnings = (self.path, self.tolerance), undetermined_weights(status)
        prior = SpectralPrior(power)
        estimate = solve(problem, prior, *how, stats=stats, warnings=warnings)
        return constrained(problem, prior, estimate, self.constraint)

    def spectra(self, problem: LineProblem) -> Float[Array, "c k"]:
        return _powers(problem.without_warnings(), (self.p, self.q)[: problem.unknowns])

    @property
    def chooses_prior(self) -> bool:
        return self.scale == "evidence"

    def prior_fixed_on(self, problem: LineProblem) -> Callable[[LineProblem], Prior]:
        refuse_constraint(self.constraint)
        problem = problem.to_grid()
        scale = np.ones(problem.unknowns)
        if self.chooses_prior:
            scale = np.asarray(_likely_scale(problem, self.spectra(problem), self.path)[0])
        return lambda each: SpectralPrior(scale[:, None] * self.spectra(each))


def _spectrum(name: str, given: Any) -> TractionSpectrum:
    wanted = "a traction spectrum, such as Exponential"
    spectrum = Exponential() if given is None else given
    return of_kind(f"method.wiener.{name}", spectrum, TractionSpectrum, wanted)


@by_numpy
def _powers(
    problem: LineProblem, spectra: tuple[TractionSpectrum, ...], xp: Any = jnp
) -> Float[Any, "c k"]:
    return xp.stack([spectrum.power(problem) for spectrum in spectra])


def _likely_scale(problem: LineProblem, power, path: str) -> tuple[Float[Numbers, " c"], Status]:
    """The factors on the powers that maximise the evidence, six decades about the data's level."""
    middle = _log_scale(problem.without_warnings(), power, problem.sample_count)
    box = jnp.stack([middle - 6, middle + 6])
    family = ScaledSpectra(power)
    problem = to_score(problem, family, box, path)
    choice = Evidence().choose(LineScorer(family, problem, path), box)
    return 10.0**choice.log_weights, choice.status


@by_numpy
def _log_scale(problem: LineProblem, power, samples: int, xp: Any = jnp) -> Float[Any, " c"]:
    """log10 of the factors under which each component alone would make the data's power."""
    gain = xp.max(xp.abs(problem.forward.circulant().transfer) ** 2, axis=(0, 2))
    observed = 1.0 if problem.observed is None else problem.observed
    left = problem.data - problem.free_offset(problem.data)
    data = xp.sum(observed * left**2) / samples
    return xp.log10(data / gain / xp.mean(power, axis=-1))
