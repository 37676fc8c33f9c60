"""The Wiener filter, the paper's (15): noise and traction spectra given."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import BadInput, choice, number, of_kind, refuse
from ..forward.noise import exponential_spectrum
from ..grid import Line, as_real, half_spectrum_weights
from ..known import array_module, as_number, by_numpy, is_traced, namespace
from ..status import Status
from .diagnostics import too_long_correlation, undetermined_weights
from .estimate import Estimate, Numbers, TractionEstimate
from .line.constrained import constrained
from .line.constraint import Constraint, checked_constraint, refuse_constraint
from .line.prior import Prior
from .line.problem import LineProblem
from .line.rule import Choice, Evidence, to_score
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

    `power` is to be defined; `length_m` and `stretched`, too, where the spectrum has a correlation
    length.
    """

    @property
    def length_m(self) -> Any:
        """The correlation length [m]; None where the spectrum has none."""
        return None

    @abc.abstractmethod
    def power(self, problem: LineProblem) -> Float[Any, " k"]:
        """S at the line's wavenumbers."""

    def stretched(self, factor: Any) -> "TractionSpectrum":
        """The spectrum of the same rms whose correlation length is `factor` times as long.

        Raises `BadInput` where a spectrum has no such length.
        """
        del factor
        raise BadInput(
            f"{type(self).__name__} has no correlation length: give "
            "method.wiener.correlation=given, or an Exponential spectrum."
        )


def _positive(name: str, value) -> Float[Array, ""]:
    return as_real(number(f"method {name}", value, "a positive number", above=0))


class Exponential(TractionSpectrum):
    """Traction of `rms_Pa`, correlated as exp(-|dx|/correlation_m)."""

    rms_Pa: Float[Array, ""]
    correlation_m: Float[Array, ""]

    def __init__(self, rms_Pa=1500.0, correlation_m=2e-3):
        self.rms_Pa = _positive("rms_Pa", rms_Pa)
        self.correlation_m = _positive("correlation_m", correlation_m)

    @property
    def length_m(self) -> Any:
        return self.correlation_m

    def power(self, problem: LineProblem) -> Float[Any, " k"]:
        line = problem.line
        return self.rms_Pa**2 * exponential_spectrum(line.k, line.cell_m, self.correlation_m)

    def stretched(self, factor: Any) -> "Exponential":
        return eqx.tree_at(lambda of: of.correlation_m, self, self.correlation_m * factor)


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
        xp = array_module(log_weights, self.power)
        return SpectralPrior(10.0 ** xp.asarray(log_weights)[:, None] * xp.asarray(self.power))


class StretchedSpectra(Family):
    """Given spectra, each multiplied by a factor, all correlation lengths by another one, the last
    of the logarithms.

    The factors are of the power of waves shorter than the correlation length, which the data show
    best, and better than rms and length apart.
    """

    sign: ClassVar[int] = -1
    has_shape: ClassVar[bool] = True
    spectra: tuple[TractionSpectrum, ...]
    problem: LineProblem

    def __call__(self, log_weights: Float[Numbers, " c"]) -> SpectralPrior:
        xp = array_module(log_weights, self.spectra, self.problem)
        *factors, stretch = 10.0 ** xp.asarray(log_weights)
        power = _powers(self.problem, tuple(each.stretched(stretch) for each in self.spectra))
        return SpectralPrior(stretch * xp.stack(factors)[:, None] * xp.asarray(power))

    def box(self) -> Float[Array, "2 1"]:
        """The range of the last logarithm: lengths that a line can show.

        Below a quarter of a cell the traction is white, above a quarter of the line it has the
        power law of short waves alone.

        Raises `BadInput` where a spectrum has no correlation length.
        """
        lengths = [each.stretched(1.0).length_m for each in self.spectra]
        line = self.problem.line
        ends = jnp.stack([jnp.asarray(line.cell_m), line.n * jnp.asarray(line.cell_m)]) / 4
        middle = sum(jnp.log10(each) for each in lengths) / len(lengths)
        return (jnp.log10(ends) - middle)[:, None]


LEVELS = ("given", "evidence")
SHORTER = 0.25  # of a correlation length, at which the evidence for a shorter one is looked for
STRONG = 3.0  # gain in log evidence, a ratio of 20, that is called strong (Kass and Raftery 1995)


class Wiener(Method):
    """Wiener's filter: the posterior mean of p and q under Gaussian priors of stated spectra.

    It solves (G^H N^-1 G + S^-1)^-1 G^H N^-1 m: m the signal, N the noise's power, S the spectra.

    - `p`, `q`: their spectra, as `srsinv.inverse.wiener.Exponential(rms_Pa, correlation_m)`, the
      default with 1500 Pa and 2 mm; p and q are taken as independent.
    - `scale`: "given" takes their levels as they are; "evidence" multiplies each by the number
      under which the data are most likely.
    - `correlation`: "given" takes their correlation lengths as they are; "evidence", beside
      scale="evidence", multiplies both by the number under which the data are most likely. Take it
      where a texture may be finer than the stated length: bands are too narrow there.
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
    correlation: str = eqx.field(static=True)
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
        correlation: Any = "given",
    ):
        self.p, self.q = _spectrum("p", p), _spectrum("q", q)
        self.scale = choice("method.wiener.scale", scale, LEVELS)
        self.correlation = choice("method.wiener.correlation", correlation, LEVELS)
        refuse(
            self.correlation == "evidence" and self.scale == "given",
            "method.wiener.correlation=evidence needs method.wiener.scale=evidence: give both.",
        )
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
        if self.scale == "given":
            return self._solved(problem, self.spectra(problem))
        family = self._family(problem)
        chosen = self._likely(problem, family)
        power, stats = family(chosen.log_weights).power, {"scale_rule": chosen.status}
        warnings = undetermined_weights(chosen.status)
        if family.has_shape:
            stats["correlation_factor"] = as_number(10.0 ** chosen.log_weights[-1])
        elif not is_traced(problem, chosen) and self._is_too_long(problem, chosen):
            warnings = (*warnings, *too_long_correlation())

        def weakened(decades: float) -> Estimate:
            return self._solved(problem, as_real(power / 10**decades), stats, warnings)

        return conditioned(weakened)

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

    def _family(self, problem: LineProblem) -> ScaledSpectra | StretchedSpectra:
        """The spectra that the evidence chooses from."""
        if self.correlation == "given":
            return ScaledSpectra(self.spectra(problem))
        return StretchedSpectra((self.p, self.q)[: problem.unknowns], problem.without_warnings())

    def _likely(self, problem: LineProblem, family: ScaledSpectra | StretchedSpectra) -> Choice:
        """The log10 numbers of greatest evidence, within six decades about the data's level."""
        power = family(np.zeros(problem.unknowns + family.has_shape)).power
        middle = _log_scale(problem.without_warnings(), power, problem.sample_count)
        # The ends of the levels are arbitrary, those of the lengths are the line's.
        box = jax.lax.stop_gradient(jnp.stack([middle - 6, middle + 6]))
        if isinstance(family, StretchedSpectra):
            box = jnp.concatenate([box, family.box()], axis=1)
        problem = to_score(problem, family, box, self.path)
        chosen = Evidence().choose(LineScorer(family, problem, self.path), box)
        if not family.has_shape or is_traced(chosen, box):
            return chosen
        # A length at an end is a limit of the spectrum: white, or the power law of short waves.
        logs, (low, high) = np.asarray(chosen.log_weights), np.asarray(box)
        is_end = np.any((logs <= low)[:-1] | (logs >= high)[:-1])
        return Choice(chosen.log_weights, Status.RANGE_END if is_end else Status.CONVERGED)

    def _is_too_long(self, problem: LineProblem, chosen: Choice) -> bool:
        """Whether the data favour spectra of a shorter correlation length, at the same power of
        short waves."""
        spectra = (self.p, self.q)[: problem.unknowns]
        if any(each.length_m is None for each in spectra):
            return False
        family = StretchedSpectra(spectra, problem.without_warnings())
        rows = [[*chosen.log_weights, np.log10(each)] for each in (1.0, SHORTER)]
        scorer = LineScorer(family, problem, self.path)
        own, shorter = scorer.values(Evidence.criterion, np.array(rows))
        return bool(own - shorter > STRONG)

    def _solved(
        self,
        problem: LineProblem,
        power: Float[Array, "c k"],
        further: Mapping[str, Any] | None = None,
        warnings: Sequence[str] = (),
    ) -> TractionEstimate:
        """The estimate of these spectra."""
        stats: dict = {"method": "wiener", "scale": self.scale, **(further or {})}
        stats |= {
            f"rms_{c}_Pa": as_number((half_spectrum_weights(problem.line.n) @ s) ** 0.5)
            for c, s in zip("pq", power if is_traced(power) else np.asarray(power), strict=False)
        }
        prior = SpectralPrior(power)
        how = self.path, self.tolerance
        estimate = solve(problem, prior, *how, stats=stats, warnings=warnings)
        return constrained(problem, prior, estimate, self.constraint)

    def spectra(self, problem: LineProblem) -> Float[Array, "c k"]:
        return _powers(problem.without_warnings(), (self.p, self.q)[: problem.unknowns])

    @property
    def chooses_prior(self) -> bool:
        return self.scale == "evidence"

    def prior_fixed_on(self, problem: LineProblem) -> Callable[[LineProblem], Prior]:
        refuse_constraint(self.constraint)
        if not self.chooses_prior:
            return lambda each: SpectralPrior(self.spectra(each))
        problem = problem.to_grid()
        log_weights = np.asarray(self._likely(problem, self._family(problem)).log_weights)
        return lambda each: self._family(each)(log_weights)


def _spectrum(name: str, given: Any) -> TractionSpectrum:
    wanted = "a traction spectrum, such as Exponential"
    spectrum = Exponential() if given is None else given
    return of_kind(f"method.wiener.{name}", spectrum, TractionSpectrum, wanted)


@by_numpy
def _powers(
    problem: LineProblem, spectra: tuple[TractionSpectrum, ...], xp: Any = jnp
) -> Float[Any, "c k"]:
    return xp.stack([spectrum.power(problem) for spectrum in spectra])


@by_numpy
def _log_scale(problem: LineProblem, power, samples: int, xp: Any = jnp) -> Float[Any, " c"]:
    """log10 of the factors under which each component alone would make the data's power."""
    gain = xp.max(xp.abs(problem.forward.circulant().transfer) ** 2, axis=(0, 2))
    observed = 1.0 if problem.observed is None else problem.observed
    left = problem.data - problem.free_offset(problem.data)
    data = xp.sum(observed * left**2) / samples
    return xp.log10(data / gain / xp.mean(power, axis=-1))
