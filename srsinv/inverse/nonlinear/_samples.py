"""Posterior samples as an answer: parameters with intervals, and how far to trust both."""

import importlib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from ...errors import BadInput
from ...numerics import BAND_90
from ...status import Status
from ...views import Arrays, ViewData, Views
from ..quality import Quality, quality, reasons
from ._convergence import TAILS, Convergence, convergence
from ._parameters import Tree
from ._sampler import Sampled

# Vehtari et al. (2021) ask for both limits: above and below them quantiles are not stable.
MOST_R_HAT, LEAST_ESS = 1.01, 400
APART_R_HAT = 1.1  # of Gelman and Rubin (1992): chains beyond it sample different regions
NOT_GAUSSIAN = 0.1  # of a standard error by which the standard deviation or an end is off
CHANCE = 3.0  # standard deviations of the Monte Carlo error that count as chance
END_DENSITY = 0.10314  # of the standard normal at its 5 and 95 % quantiles
MOST_NAMES = 3  # in a sentence


@dataclass(frozen=True, repr=False)
class PosteriorSamples(Views):
    """Draws from the posterior of parameters, by [`sample`][srsinv.sample].

    `print` gives a report; `plot`, `to_xarray`, `to_dataframe` and `to_inference_data` give a
    figure, arrays, a table and the data that ArviZ takes.

    - `names` (m,): the parameters; `draws` (chain, draw, m): their values, in SI units.
    - `params`: a tree like the parameters, each leaf with leading axes (chain, draw).
    - `mean`, `std`, `low`, `high`: mean, standard deviation, 5 and 95 % quantile by name.
    - `r_hat`, `ess_bulk`, `ess_tail`: by name, how well the chains agree and how many independent
      draws theirs are worth, for the mean and for the quantiles (Vehtari et al. 2021).
    - `divergences`: number of draws at which the sampler lost the energy.
    - `laplace`: value and standard error by name of the normal approximation at the mode; empty
      where there is no mode.
    - `sampler`: the log density and other numbers of each draw; `warmup`: number of draws of each
      chain before those.
    - `observed`: the data of a fit, None for a function; `inherited`: the warnings of the fit;
      `chi2`: its chi-square per degree of freedom, None where the noise was not known; `freedom`:
      number of its degrees of freedom.
    - `status`, `quality`, `warnings`, `reasons`, `stats`: as of any answer.
    """

    names: tuple[str, ...]
    draws: Float[np.ndarray, "chain draw m"]
    params: Tree
    laplace: Mapping[str, tuple[float, float]]
    sampler: Sampled
    observed: np.ndarray | None
    warmup: int
    inherited: tuple[str, ...] = ()
    chi2: float | None = None
    freedom: float = np.inf

    def _by_name(self, values: Any) -> dict[str, float]:
        return dict(zip(self.names, map(float, values), strict=True))

    @cached_property
    def mean(self) -> dict[str, float]:
        """The mean of each parameter."""
        return self._by_name(self.draws.mean(axis=(0, 1)))

    @cached_property
    def std(self) -> dict[str, float]:
        """The standard deviation of each parameter."""
        return self._by_name(self.draws.std(axis=(0, 1), ddof=1))

    @cached_property
    def low(self) -> dict[str, float]:
        """The 5 % quantile of each parameter."""
        return self._by_name(np.quantile(self.draws, TAILS[0], axis=(0, 1)))

    @cached_property
    def high(self) -> dict[str, float]:
        """The 95 % quantile of each parameter."""
        return self._by_name(np.quantile(self.draws, TAILS[1], axis=(0, 1)))

    @cached_property
    def _convergence(self) -> dict[str, Convergence]:
        columns = np.moveaxis(self.draws, -1, 0)
        return dict(zip(self.names, map(convergence, columns), strict=True))

    @property
    def r_hat(self) -> dict[str, float]:
        """R-hat of each parameter: rank-normalised, of split chains."""
        return {name: each.r_hat for name, each in self._convergence.items()}

    @property
    def ess_bulk(self) -> dict[str, float]:
        """Effective sample size of each parameter's mean."""
        return {name: each.ess_bulk for name, each in self._convergence.items()}

    @property
    def ess_tail(self) -> dict[str, float]:
        """Effective sample size of each parameter's 5 and 95 % quantiles, the lesser."""
        return {name: each.ess_tail for name, each in self._convergence.items()}

    @property
    def divergences(self) -> int:
        """Number of draws at which the sampler lost the energy."""
        return int(self.sampler.is_divergent.sum())

    @cached_property
    def status(self) -> Status:
        """Whether the chains sample the same region."""
        agree = max(self.r_hat.values()) <= APART_R_HAT
        return Status.CONVERGED if agree else Status.CHAINS_DIFFER

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on the samples, and on standard errors in their place, as sentences."""
        return (*self.inherited, *self._of_sampler(), *self._of_laplace())

    @property
    def quality(self) -> Quality:
        """Good, doubtful (any warning), or failed: the chains differ, or the fit failed."""
        return quality(self.status, self.chi2, self.warnings, self.freedom)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)

    @property
    def stats(self) -> dict[str, Any]:
        """Numbers of the sampler, and the fit's chi-square and degrees of freedom."""
        chains, draws, _ = self.draws.shape
        return {
            "chains": chains,
            "draws": draws,
            "warmup": self.warmup,
            "divergences": self.divergences,
            "acceptance": float(self.sampler.acceptance.mean()),
            "leapfrogs": int(self.sampler.leapfrogs.sum()),
            "chi2_per_freedom": self.chi2,
            "degrees_of_freedom": float(self.freedom),
        }

    def _of_sampler(self) -> tuple[str, ...]:
        said, least = [], {n: min(each[1:]) for n, each in self._convergence.items()}
        apart = {name: value for name, value in self.r_hat.items() if not value <= MOST_R_HAT}
        if apart:
            said.append(
                f"The chains differ in {_listed(apart)}: R-hat is {max(apart.values()):.3f}, above "
                f"{MOST_R_HAT}. Take more draws, or bound the parameters to one of several maxima."
            )
        few = {name: value for name, value in least.items() if not value >= LEAST_ESS}
        if few:
            said.append(
                f"The draws of {_listed(few)} are worth {min(few.values()):.0f} independent ones, "
                f"fewer than {LEAST_ESS}: the quantiles are rough. Take more draws."
            )
        if count := self.divergences:
            said.append(
                f"{count} draw{'s' * (count > 1)} diverged: the chains may miss narrow regions of "
                "the posterior. Sample again with a larger acceptance, such as 0.95."
            )
        return tuple(said)

    def _of_laplace(self) -> tuple[str, ...]:
        """Whether standard deviations or ends of the intervals are off those of Laplace."""
        off = {name: self._off_laplace(name) for name in self.laplace}
        failing = {name: by for name, by in off.items() if by > NOT_GAUSSIAN}
        if not failing:
            return ()
        worst = max(failing, key=lambda name: failing[name])
        value, stderr = self.laplace[worst]
        below, above = (value - self.low[worst]) / stderr, (self.high[worst] - value) / stderr
        are = (
            f"posterior of {worst} is"
            if len(failing) == 1
            else f"posteriors of {_listed(failing)} are"
        )
        of = "" if len(failing) == 1 else f" of {worst}"
        return (
            f"The {are} not Gaussian: the 90 % interval{of} ends {below:.3g} standard errors below "
            f"the mode and {above:.3g} above, not {BAND_90:.3g}. Quote intervals of the samples.",
        )

    def _off_laplace(self, name: str) -> float:
        """How far the standard deviation or an end is off, in standard errors, beyond chance."""
        value, stderr = self.laplace[name]
        if not 0 < stderr < np.inf:
            return 0.0
        half, of = BAND_90 * stderr, self._convergence[name]
        by_chance = self.std[name] / np.sqrt(2 * of.ess_bulk)
        off = [abs(self.std[name] - stderr) - CHANCE * by_chance]
        tail = np.sqrt(TAILS[0] * TAILS[1] / of.ess_tail) / END_DENSITY
        for end, normal in ((self.low, value - half), (self.high, value + half)):
            off.append(abs(end[name] - normal) - CHANCE * tail * self.std[name])
        return max(off) / stderr

    def view_data(self) -> ViewData:
        columns = zip(*self._convergence.values(), strict=True)
        named = dict(zip(Convergence._fields, columns, strict=True))
        variables: Arrays = {
            name: ("reported", np.array(each), "1") for name, each in named.items()
        }
        variables |= {
            "posterior_draws": (("chain", "draw", "reported"), self.draws, "SI"),
            "log_density": (("chain", "draw"), self.sampler.log_density, "1"),
            "is_divergent": (("chain", "draw"), self.sampler.is_divergent.astype(np.int8), "1"),
            **{f"laplace_{what}": ("reported", values, "SI") for what, values in self._normal()},
        }
        chains, draws, count = self.draws.shape
        coordinates: Arrays = {"chain": (np.arange(chains), "1"), "draw": (np.arange(draws), "1")}
        title = f"Posterior samples of {count} parameter{'s' * (count != 1)}"
        pairs = {name: (self.mean[name], self.std[name]) for name in self.names}
        ends = {name: (self.low[name], self.high[name]) for name in self.names}
        return ViewData(title, variables, coordinates, pairs, {}, intervals=ends)

    def _normal(self) -> list[tuple[str, list[float]]]:
        every = [self.laplace.get(name, (np.nan, np.nan)) for name in self.names]
        return [("value", [each[0] for each in every]), ("stderr", [each[1] for each in every])]

    def to_inference_data(self) -> Any:
        """The draws as ArviZ takes them: groups posterior, sample_stats and observed_data.

        An `InferenceData` of ArviZ 0, a tree of datasets of ArviZ 1. Raises `BadInput` where ArviZ
        is not installed.
        """
        posterior = {name: self.draws[..., i] for i, name in enumerate(self.names)}
        sampler = self.sampler
        stats = {
            "lp": sampler.log_density,
            "diverging": sampler.is_divergent,
            "acceptance_rate": sampler.acceptance,
            "energy": sampler.energy,
            "n_steps": sampler.leapfrogs,
            "step_size": np.broadcast_to(sampler.step_size[:, None], sampler.energy.shape),
        }
        groups = {"posterior": posterior, "sample_stats": stats}
        if self.observed is not None:
            groups["observed_data"] = {"y": self.observed}
        return _inference_data(groups)


def _inference_data(groups: Mapping[str, Mapping[str, Any]]) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # ArviZ 0 announces ArviZ 1
            arviz: Any = importlib.import_module("arviz")
    except ImportError as error:
        raise BadInput(
            "to_inference_data needs arviz, which is not installed: type "
            "pip install 'srsinv[sample]'."
        ) from error
    is_first = arviz.__version__.startswith("0.")
    return arviz.from_dict(**groups) if is_first else arviz.from_dict(groups)


def _listed(names: Mapping[str, float]) -> str:
    """The names of the largest values, and how many more there are."""
    few = list(names)[:MOST_NAMES]
    if len(names) > MOST_NAMES:
        return f"{', '.join(few)} and {len(names) - MOST_NAMES} more"
    return " and ".join([", ".join(few[:-1]), few[-1]] if len(few) > 1 else few)
