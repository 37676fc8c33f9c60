"""A surface pressed on once, and the signal that it gives with any friction: at nu = 1/2 friction
does not change the pressure."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..compiled import compiled
from ..errors import BadInput, refuse
from ..forward.contact import Contact
from ..forward.scene import SurfaceScene
from ..forward.simulation import Simulation, response
from ..forward.surface import Surface
from ..numerics import is_flat
from .estimate import Estimate
from .features.fit import FeatureFitter
from .features.loading import Features
from .gridding.cells import Window
from .line.problem import LineProblem
from .simulated import problem_of


class SolvedContact(eqx.Module):
    """A simulation of a surface, its contact solved on the finer line.

    Tractions are cell averages (2, n) less the background, as those of the simulation. Raises
    `BadInput` for a scene without a surface.
    """

    sim: Simulation
    scene: SurfaceScene
    contact: Contact

    def __init__(self, sim: Simulation):
        scene = sim.scene.contact_scene
        if scene is None:
            kind = type(sim.scene).__name__
            raise BadInput(f"scene is a {kind}: give one of a surface, such as scene=ridge.")
        refuse(
            sim.scenario.recorder.samples_in_time,
            "effects names one that acts in time (sampling, a varying speed or load), "
            "but this job takes one sample per cell: leave it out.",
        )
        self.sim, self.scene = sim, scene
        self.contact = scene.contact(sim.fine)

    @property
    def surface(self) -> Surface:
        """What the skin is pressed on."""
        return self.scene.surface

    @property
    def window(self) -> Window:
        """The stretch with which the contact repeats: the finer line's cells."""
        fine = self.sim.fine
        start = float(fine.x[0] - fine.cell_m / 2)
        return Window(start, start + fine.n * float(fine.cell_m))

    @compiled
    def fine_traction(self, surface: Surface | None = None) -> Float[Array, "2 fine"]:
        """p and q on the finer line, with the friction of `surface` in place of its own."""
        sim, of = self.sim, self.surface if surface is None else surface
        scene, direction = eqx.tree_at(lambda s: s.surface, self.scene, of), sim.scan.direction
        traction = scene.traction(sim.fine, direction, self.contact.pressure_Pa)
        # On the periodic line nothing is taken out: its background is zero.
        level = jnp.where(jnp.any(sim.background), scene.background(direction), 0.0)
        return traction - level[:, None]

    def traction(self, surface: Surface | None = None) -> np.ndarray:
        """The same averaged over the cells of the line of the estimate."""
        return cell_averages(self.fine_traction(surface), self.sim.refinement)

    def signal(self, surface: Surface | None = None) -> Float[Array, "e n"]:
        """The signal without noise at the line's positions."""
        sim = self.sim
        stage = sim.sensor.output(sim.scan)
        return response(stage, sim.fine, self.fine_traction(surface), sim.refinement)

    def problem(self, key, friction=None) -> LineProblem:
        """The signal with noise, and what inverts it; the mean pressure is known as the load."""
        mean_p = jnp.mean(self.fine_traction()[0])
        return problem_of(self.sim, self.signal(), mean_p, key, friction)

    def fit(self, features: Features, problem: LineProblem) -> Estimate:
        """Features of a surface fitted to a problem's signal, the load and the skin known. White
        noise is known, any other is estimated from the residual."""
        samples, power = problem.samples(), np.asarray(problem.noise)[:, 1:]
        given = self.window, float(self.scene.nominal_pressure_Pa)
        fitter = FeatureFitter.on_window(samples.sensor, samples.motion, features, *given)
        return fitter(features, samples.signal, samples.noise if is_flat(power) else None)


def cell_averages(values, refinement: int) -> np.ndarray:
    """Averages over cells `refinement` times wider (..., n), around every so many cells' centre.

    Everything repeats with the window.
    """
    values, half = np.asarray(values), refinement // 2
    weights = np.ones(2 * half + 1)
    if refinement % 2 == 0:
        weights[[0, -1]] = 0.5  # the outermost cells are cut in two
    shifted = [w * np.roll(values, half - i, axis=-1) for i, w in enumerate(weights)]
    return np.sum(shifted, axis=0)[..., ::refinement] / refinement


def smoothed_truth(
    truth: Float[np.ndarray, "2 n"], estimate: Estimate, circular: bool
) -> Float[np.ndarray, "2 n"]:
    """The truth as the averaging kernels of an estimate of p and q show it, without any noise; NaN
    where it has none."""
    if estimate.averaging is None:
        return np.full(truth.shape, np.nan)
    n = truth.shape[-1]
    size = n if circular else 2 * n
    kernels = np.fft.rfft(np.asarray(estimate.averaging), size)
    resolved = np.fft.irfft(np.einsum("ijk,jk->ik", kernels, np.fft.rfft(truth, size)), size)
    # A kernel has its middle at cell n // 2.
    return np.roll(resolved, -(n // 2), axis=-1)[:, :n]
