"""Forward model: from traction to the signal, by cells, line, precision, refinement and package."""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from itertools import product
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..forward.simulation import Simulation
from ..grid import LINES, Convolution
from ._cost_settings import CostSettings
from ._cost_trials import cost_trial, relative
from .trials import Row, Trial, Work

GROUP, GRADIENT = "forward", "gradient"  # the part of the signal, and that of its derivative
FINER = 16  # refinement of a trial's reference: where sizes are powers of 4, it has one of theirs
MOST_CELLS = 2**21  # of the reference
POINT = 16  # a point sample is the average over this part of a cell, at its centre
CACHED = 4  # models, of one size and its lines, which several trials take
NUMPY = "numpy"  # the peer to compare times with

Simulated = Callable[[str, int], Simulation]  # by the kind of line and the number of cells


def trials(
    simulated: Simulated, settings: CostSettings, peers: ModuleType | None
) -> Iterator[Trial]:
    """Every way to the signal, at every number of cells."""
    model = ForwardModel(simulated, min(settings.forward_cells))
    others = {} if peers is None else peers.FORWARD
    for cells, (family, work) in product(sorted(settings.forward_cells), model.ways().items()):
        for line in LINES:
            yield model.trial(line, cells, family, work)
            if family == "float64":
                yield model.trial(line, cells, family, model.gradient, part=GRADIENT)
                for name, other in others.items():
                    yield model.trial(
                        line, cells, name, partial(model.by_peer, other), is_peer=True
                    )


class ForwardModel:
    """The forward model at several numbers of cells, and what its signals are compared with at
    `common` positions, which all of them have."""

    def __init__(self, simulated: Simulated, common: int):
        self.simulated, self.common = simulated, common
        self.model, self.exact = lru_cache(CACHED)(self._model), lru_cache(CACHED)(self._exact)
        self.reference = lru_cache(self._reference)

    def ways(self) -> dict[str, Callable[[str, int], Work]]:
        """What prepares a work, by the names of families."""
        return {
            "float64": partial(self._applied, double=True),
            "float32": partial(self._applied, double=False),
            "point samples": self._of_points,
            "refined": self._refined,
        }

    def trial(
        self, line: str, cells: int, family: str, prepare: Callable[[str, int], Work],
        part: str = GROUP, is_peer: bool = False,
    ) -> Trial:  # fmt: skip
        """One of them as a trial."""
        return cost_trial(
            GROUP, part, line, family, cells,
            prepare=partial(prepare, line, cells),
            score=partial(self._score, part, line, cells, family),
            peer=NUMPY, is_peer=is_peer, rests_on={"common": self.common},
        )  # fmt: skip

    def by_peer(self, other: Callable[..., Any], line: str, cells: int) -> Work:
        """A peer's work."""
        return partial(other, *self.model(line, cells))

    def _score(self, part: str, line: str, cells: int, family: str, value) -> Row:
        value, is_gradient = np.asarray(value, float), part == GRADIENT
        reference = self.reference(line, cells, is_gradient)
        measures = {
            "error": relative(value[:, :: cells // self.common], reference),
            "applications": 2.0 if is_gradient else 1.0,
        }
        if not is_gradient and family in ("float64", "float32", NUMPY):
            measures["algebraic_error"] = relative(value, self.exact(line, cells))
        return measures

    def _model(self, line: str, cells: int):
        """The operator, and the traction that it is applied to."""
        sim = self.simulated(line, cells)
        return sim.sensor.operator(sim.line, sim.scan), sim.traction(sim.line)

    def _exact(self, line: str, cells: int) -> np.ndarray:
        """The signal in double precision."""
        operator, traction = self.model(line, cells)
        return np.asarray(operator(traction))

    def _reference(self, line: str, cells: int, is_gradient: bool) -> np.ndarray:
        """The signal, or the gradient of half its squares, at the common positions, from finer
        cells."""
        finer = max(min(FINER * cells, MOST_CELLS - MOST_CELLS % cells), cells)
        operator, traction = self._model(line, finer)
        signal = operator(traction)
        values = operator.adjoint(signal) if is_gradient else signal
        return np.asarray(values)[:, :: finer // self.common]

    def _applied(self, line: str, cells: int, double: bool) -> Work:
        """The operator on cell averages, in double or single precision."""
        with jax.enable_x64(double):
            operator, traction = self.model(line, cells) if double else self._model(line, cells)

        def work():
            with jax.enable_x64(double):
                return operator(traction)

        return work

    def _of_points(self, line: str, cells: int) -> Work:
        """The operator on samples of the traction at the cells' centres."""
        sim = self.simulated(line, cells)
        coarse = sim.line
        line_of_points = type(coarse)(cells * POINT, coarse.cell_m / POINT, coarse.start_m)
        narrow = sim.traction(line_of_points)
        return partial(self.model(line, cells)[0], narrow[:, ::POINT])

    def _refined(self, line: str, cells: int) -> Work:
        """From finer cells, as a simulation does."""
        sim = self.simulated(line, cells)
        operator, traction = sim.sensor.operator(sim.fine, sim.scan), sim.traction(sim.fine)
        return lambda: operator(traction)[:, :: sim.refinement]

    def gradient(self, line: str, cells: int) -> Work:
        """The gradient of half the signal's squares by the traction."""
        operator, traction = self.model(line, cells)
        return partial(_slope, operator, traction)


@jax.jit
def _slope(operator: Convolution, traction):
    return jax.grad(lambda r: jnp.sum(operator(r) ** 2) / 2)(traction)
