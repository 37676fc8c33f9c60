"""The signal and the stress at the films of a simulation, for screening: one traction for both.

On the periodic line in numpy, of the skin's and the films' factors: which effects are on differs
with every scene and every round, and a program for each would take longer to compile.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Inexact

from ..compiled import compiled
from ..forward.film import LineEffect
from ..forward.sensor import FilmSignal, FilmStress
from ..forward.simulation import Simulation
from ..forward.skin import STRESSES
from ..forward.turned_skin import along_x
from ..grid import Periodic, Stage, as_real


def signal_and_stress(
    sim: Simulation,
) -> tuple[Float[np.ndarray, "e n"], Float[np.ndarray, "e 4 n"]]:
    """The noise-free signal and the stress [Pa] at the coarse line's positions, computed on the
    fine one."""
    sensor, line = sim.sensor, sim.fine
    output = sensor.output(sim.scan)
    if sensor.envelopes or not isinstance(line, Periodic):
        both = np.asarray(sim.response(_SignalAndStress(output, sensor.stress())))
        count = len(sensor.elements)
        return both[:count], both[count:].reshape(count, len(STRESSES), -1)
    k = 2 * np.pi * np.fft.rfftfreq(line.n, np.asarray(line.cell_m))
    # Cell averages, as in `Periodic.operator`.
    mean = np.sinc(k * np.asarray(line.cell_m) / (2 * np.pi))
    traction = np.fft.rfft(np.asarray(sim.traction(line))) / mean
    depths = [float(film.depth_m) for film in output.elements]
    transfer = {depth: output.skin.transfer_once(k, depth) for depth in set(depths)}
    stress = np.stack([np.einsum("sck,ck->sk", transfer[depth], traction) for depth in depths])
    readout = np.asarray(output.gain) * (1j * k if output.order else 1.0)
    rows = []
    for given, own in zip(output.elements, stress, strict=True):
        film, skin = along_x(given, output.skin)
        if skin is not output.skin:
            own = np.einsum("sck,ck->sk", skin.transfer_once(k, float(film.depth_m)), traction)
        weights = jax.tree.map(np.asarray, film).charge_per_stress(np)
        along_line = np.ones_like(k)
        for effect in film.all_effects:
            along_line = along_line * np.asarray(_factor(effect, as_real(k)))
        rows.append(readout * (weights @ own) * along_line)
    signal = np.stack(rows)
    at = slice(None, None, sim.refinement)
    return np.fft.irfft(signal, line.n)[..., at], np.fft.irfft(stress, line.n)[..., at]


@compiled
def _factor(effect: LineEffect, k: Float[Array, " k"]) -> Inexact[Array, " k"]:
    return effect.transfer(k)


class _SignalAndStress(Stage):
    """The recorded signal and the stress at the films, rows one after another."""

    signal: FilmSignal
    stress: FilmStress

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "e c k"]:
        return jnp.concatenate([self.signal.transfer(k), self.stress.transfer(k)])

    def cell_response(
        self, x: Float[Array, " x"], cell_m: Float[Array, ""]
    ) -> Float[Array, "e c x"]:
        both = self.signal, self.stress
        return jnp.concatenate([each.cell_response(x, cell_m) for each in both])
