"""Time of an admissible traction on 1,024 cells, once compiled, and its distance from the minimum.

    python -m benchmarks.admissible

The command takes half a minute.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

import srsinv
from srsinv.forward.sensor import two_orientations
from srsinv.forward.surface import Cylinder, Ridge, Rough, SineWave
from srsinv.inverse.line.constrained import TOLERANCE, centred_posterior, penalties
from srsinv.inverse.line.splitting import PerWave, minimise

CELLS, WINDOW_M, REPEATS = 1024, 0.04, 20
EXACT, MOST_STEPS = 1e-5, 100_000
SCENES = {
    "wave": (2e4, SineWave(1.82e-4, 8e-3)),
    "cylinder": (2e3, Cylinder(0.02)),
    "texture": (3e3, Rough(3e-5, 1e-2, 4e-4, seed=2)),
    "ridge": (2e3, Ridge(1e-4, 3e-3)),
}


def main() -> None:
    """Print a row for each scene and constraint."""
    line = srsinv.Periodic(CELLS, WINDOW_M / CELLS, -WINDOW_M / 2)
    sensor, scan = srsinv.Sensor(two_orientations()), srsinv.ConstantSpeed(0.05)
    print("scene      friction_max  steps     ms  worst cell in standard errors")
    for name, (load, shape) in SCENES.items():
        scene = srsinv.SurfaceScene(load, [shape], 0.4)
        noise = [srsinv.SignalToNoise(30.0)]
        problem = srsinv.simulate(srsinv.Scenario(scene, sensor, scan, noise), line).problem
        problem = problem.to_grid()
        prior = srsinv.Wiener(scale="evidence").prior_fixed_on(problem)(problem)
        for most in (None, 1.0):
            row = measured(problem, prior, srsinv.Admissible(most))
            print(f"{name:10} {most!s:12} {row[0]:6d} {row[1]:6.2f}  {row[2]:.1e}")


def measured(problem, prior, constraint) -> tuple[int, float, float]:
    """Steps, the least time [ms] of a call, and the distance of the worst cell from the minimum."""
    with jax.enable_x64(True):
        of = centred_posterior(problem, prior, constraint)
        about = (
            of.posterior, jnp.asarray(of.mean)[None], constraint,
            penalties(problem, prior, constraint, of),
        )  # fmt: skip
        assert isinstance(of.posterior, PerWave)
        exact = minimise(*about, EXACT, MOST_STEPS)
        found, times = minimise(*about, TOLERANCE, MOST_STEPS), []
        for _ in range(REPEATS):
            begun = time.perf_counter()
            found = jax.block_until_ready(minimise(*about, TOLERANCE, MOST_STEPS))
            times.append(time.perf_counter() - begun)
        variance = np.fft.irfft(np.asarray(of.posterior.covariance)[0, 0], CELLS)[0]
        off = float(jnp.max(jnp.abs(found.value - exact.value)[0, 0])) / np.sqrt(variance)
    return int(found.steps), 1e3 * min(times), off


if __name__ == "__main__":
    main()
