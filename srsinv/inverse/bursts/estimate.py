"""The estimate of a traction and of the bursts beside it."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ...views import Arrays, ViewData
from ..estimate import TractionEstimate

LOCATED = 0.1  # of the contact, which the standard error of a place is below where it is located
QUANTITIES = {"time": "s", "place": "m", "size": "Pa", "decay": "s"}


class Found(NamedTuple):
    """A quantity of each burst: posterior mean, standard error and 90 % interval, each (burst,)."""

    value: Float[np.ndarray, " burst"]
    stderr: Float[np.ndarray, " burst"]
    low: Float[np.ndarray, " burst"]
    high: Float[np.ndarray, " burst"]

    @classmethod
    def of(cls, draws: list[np.ndarray]) -> "Found":
        """From draws of the posterior of each burst."""
        if not draws:
            return cls(*(np.zeros(0),) * 4)
        each = np.stack(draws)
        return cls(each.mean(axis=1), each.std(axis=1), *np.quantile(each, (0.05, 0.95), axis=1))


class FoundBursts(eqx.Module):
    """The bursts that are claimed, in the order of time.

    - `time`: the beginning, from the pass's first valid sample [s]; `place`: on the finger, from
      the sensor's origin [m]; `size`: of the shear [Pa]; `decay` [s].
    - `d_prime`: the signal-to-noise ratio of each; `is_located`: whether its place is known to
      within a tenth of the contact; `log_odds`: log of the averaged likelihood ratio of having it.
    - `rate_hz`: median, standard error, and ends of the 90 % interval of the rate of bursts whose
      signal-to-noise ratio is above 5; NaN where the model of the traction is wrong.
    """

    time: Found
    place: Found
    size: Found
    decay: Found
    d_prime: Float[np.ndarray, " burst"]
    is_located: Bool[np.ndarray, " burst"]
    log_odds: Float[np.ndarray, " burst"]
    rate_hz: tuple[float, float, float, float]

    def __len__(self) -> int:
        return len(self.d_prime)

    def named(
        self, ends: Callable[[Found, int], tuple[Any, Any]]
    ) -> dict[str, tuple[float, float]]:
        """Two numbers of each quantity of each burst, by its name: `burst_1_time_s`."""
        made = {}
        for j in range(len(self)):
            for name, unit in QUANTITIES.items():
                one, other = ends(getattr(self, name), j)
                made[f"burst_{j + 1}_{name}_{unit}"] = float(one), float(other)
        return made


class BurstEstimate(TractionEstimate):
    """An estimate of the traction with the bursts of catch and snap beside it, `bursts`.

    `fitted` has the bursts, and the standard errors of p and q have their uncertainty. `parameters`
    has the rate, and of each burst its quantities, as `burst_1_time_s`.
    """

    bursts: FoundBursts = eqx.field(kw_only=True)

    @property
    def intervals(self) -> Mapping[str, tuple[float, float]]:
        return self.bursts.named(lambda each, j: (each.low[j], each.high[j])) | {
            "burst_rate_hz": self.bursts.rate_hz[2:]
        }

    def view_data(self) -> ViewData:
        data, found = super().view_data(), self.bursts
        variables: Arrays = {}
        for name, unit in QUANTITIES.items():
            of: Any = getattr(found, name)
            variables |= {
                f"burst_{name}": ("burst", of.value, unit),
                f"burst_{name}_stderr": ("burst", of.stderr, unit),
                f"burst_{name}_low": ("burst", of.low, unit),
                f"burst_{name}_high": ("burst", of.high, unit),
            }
        variables |= {
            "burst_d_prime": ("burst", found.d_prime, "1"),
            "burst_is_located": ("burst", found.is_located.astype(np.int8), "1"),
            "burst_log_odds": ("burst", found.log_odds, "1"),
        }
        coordinates = data.coordinates | {"burst": (np.arange(len(found.d_prime)), "1")}
        return data._replace(variables=data.variables | variables, coordinates=coordinates)
