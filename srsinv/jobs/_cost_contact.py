"""Contact: the pressure under a rigid wave, by cells, tolerance and start, and by Tamaas.

Westergaard's contact (Johnson 1985, 13.2) has a closed form that repeats with the window, as the
solvers' contact does: under h = D cos(2 pi x/L) at a mean pressure of s^2 times that of full
contact, pi E* D/L,

    p = 2 p0 cos(pi x/L) sqrt(s^2 - sin^2(pi x/L))/s^2  where sin^2(pi x/L) < s^2.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..forward.contact import Contact, cell_compliance, press
from ..forward.contact_elastic import iterate
from ..forward.skin import HalfSpace
from ..grid import Periodic
from ..status import Status
from ._cost_settings import CostSettings
from ._cost_trials import cost_trial, relative
from .trials import Row, Trial, Work

PART = "contact"
LENGTH_M, AMPLITUDE_M = 0.02, 1e-5
LOAD = 0.5  # s^2, over the pressure of full contact
PLACE = 0.29  # of a cell, by which the crest lies beside a centre: no edge lies on a cell's own
MOST_STEPS = 3000
TAMAAS = "tamaas, 1e-08"  # the peer to compare times with
PRESS = "as called"  # the family of `press`, which begins many cells on wider ones


def trials(settings: CostSettings, peers: ModuleType | None) -> Iterator[Trial]:
    """The contact as it is called, by descent alone to several tolerances, and by peers."""
    for cells in sorted(settings.contact_cells):
        wave = Wave(cells)
        yield wave.trial(PRESS, wave.pressed)
        for tolerance in settings.tolerances:
            work = partial(wave.descended, tolerance)
            yield wave.trial(f"from no pressure, {tolerance:g}", work)
        others = {} if peers is None else peers.contacts(settings.tolerances)
        for family, other in others.items():
            yield wave.trial(family, partial(wave.by_peer, other), family)


class Wave:
    """The wave on so many cells."""

    def __init__(self, cells: int):
        self.cells, self.skin = cells, HalfSpace()
        self.solved = lru_cache(lambda: np.asarray(self.pressed()().pressure_Pa))

    def trial(self, family: str, prepare: Callable[[], Work], peer: str = TAMAAS) -> Trial:
        """One way of solving it as a trial."""
        return cost_trial(
            PART, PART, "periodic", family, self.cells,
            prepare=prepare, score=self._score, is_peer=peer == family, peer=peer,
        )  # fmt: skip

    @property
    def line(self) -> Periodic:
        """The cells."""
        cell = LENGTH_M / self.cells
        return Periodic(self.cells, cell, -LENGTH_M / 2 + PLACE * cell)

    @property
    def height_m(self) -> Float[Array, " n"]:
        """The profile at the cells' centres."""
        return AMPLITUDE_M * jnp.cos(2 * jnp.pi * self.line.x / LENGTH_M)

    @property
    def modulus_Pa(self) -> float:
        """E*, as a wave's compliance is 2/(E* k)."""
        return float(2 / self.skin.compliance(jnp.ones(1))[0])

    @property
    def nominal_Pa(self) -> float:
        """The mean pressure."""
        return LOAD * np.pi * self.modulus_Pa * AMPLITUDE_M / LENGTH_M

    def pressed(self) -> Work:
        """As it is called."""
        return partial(press, self.line, self.skin, self.height_m, self.nominal_Pa)

    def descended(self, tolerance: float) -> Work:
        """By descent on these cells alone, from no pressure anywhere, to a tolerance on the gap."""
        height = self.height_m - jnp.max(self.height_m)
        compliance, nominal = cell_compliance(self.line, self.skin), jnp.asarray(self.nominal_Pa)
        return partial(_descend, height, nominal, compliance, tolerance)

    def by_peer(self, other: Callable[..., Work]) -> Work:
        """A peer's work."""
        return other(np.asarray(self.height_m), LENGTH_M, self.nominal_Pa, self.modulus_Pa)

    def exact(self) -> np.ndarray:
        """The closed form's cell averages (n,) [Pa], differences of the load up to a place."""
        x, half = np.asarray(self.line.x), LENGTH_M / self.cells / 2
        return (self._load(x + half) - self._load(x - half)) / (2 * half)

    def _load(self, x: np.ndarray) -> np.ndarray:
        """The load [N/m] up to x, odd about the crest."""
        periods = np.round(x / LENGTH_M)
        sine = np.sin(np.pi * (x / LENGTH_M - periods)) / np.sqrt(LOAD)
        inside = np.clip(sine, -1, 1)
        half = (inside * np.sqrt(1 - inside**2) + np.arcsin(inside)) / np.pi
        return self.nominal_Pa * LENGTH_M * (half + periods)

    def _score(self, given: Any) -> Row:
        """Against the closed form, and against the solution on the same cells."""
        pressure, steps, failure = _read(given)
        return {
            "error": relative(pressure, self.exact()),
            "algebraic_error": relative(pressure, self.solved()),
            "applications": steps,
            "failure": failure,
        }


def _read(given: Any) -> tuple[np.ndarray, float, str]:
    """The pressure, the steps, and why it is no answer."""
    if isinstance(given, Contact):
        steps, converged = float(given.iterations), bool(given.converged)
        return np.asarray(given.pressure_Pa), steps, "" if converged else str(given.status)
    if isinstance(given, tuple):
        pressure, steps = np.asarray(given[0]), float(given[1])
        return pressure, steps, "" if steps < MOST_STEPS else str(Status.STEP_LIMIT)
    return np.asarray(given), np.nan, ""


@partial(jax.jit, static_argnums=3)
def _descend(height, nominal, compliance, tolerance: float):
    """Pressure and steps."""
    start = jnp.zeros_like(height)
    deviation, steps = iterate(height, nominal, compliance, start, MOST_STEPS, tolerance)
    return nominal + deviation, steps
