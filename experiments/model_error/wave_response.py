"""Response of an inversion to sinusoids of a sensor that may be another than the assumed one.

It is 1 from a component into itself and 0 into the other where all is right.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from srsinv.grid import Line, Operator
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.method import Method


def whole_waves(
    line: Line, wavelengths_m: Float[np.ndarray, " length"]
) -> Int[np.ndarray, " wave"]:
    """Numbers of whole waves on the line nearest to the given wavelengths, increasing, each once;
    at least one, and fewer than half the cells."""
    wanted = line.n * float(line.cell_m) / wavelengths_m
    return np.unique(np.clip(np.round(wanted).astype(int), 1, line.n // 2 - 1))


def wave_response(
    method: Method, problem: LineProblem, sensor: Operator, waves: Int[np.ndarray, " wave"]
) -> Complex[np.ndarray, "2 2 wave"]:
    """Complex amplitude recovered per unit of a true sinusoid: (component recovered, component
    there, wave).

    - `problem`: what the method assumes, on a periodic line; each sinusoid's signal is as strong as
      its data, and without noise.
    - `sensor`: makes the signals.
    - `waves`: numbers of whole waves on the line, see [`whole_waves`][].
    """
    line = problem.line
    size = np.sqrt(np.mean(np.asarray(problem.data) ** 2))
    response = np.zeros((2, 2, waves.size), complex)
    for at, m in enumerate(waves):
        wave = np.cos(2 * np.pi * m * np.arange(line.n) / line.n)
        for c, component in enumerate(np.eye(2)):
            data = sensor(jnp.asarray(np.outer(component, wave)))
            scale = size / np.sqrt(np.mean(np.asarray(data) ** 2))
            given = LineProblem(
                line, problem.forward, scale * data, problem.noise, known_mean_Pa=(0.0, None)
            )
            recovered = np.fft.rfft(np.asarray(method(given).value))[:, m]
            response[:, c, at] = recovered / scale / np.fft.rfft(wave)[m]
    return response
