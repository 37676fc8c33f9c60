"""Single precision: the same program at float32, to a few of its own round-offs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.amplifier import CurrentAmplifier, IntegratedCurrent
from srsinv.forward.noise import Johnson, SignalToNoise, Sliding, White, draw, total_spectrum
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import TractionScene
from srsinv.forward.traction import FrictionStep, PressedStrip, Sinusoid
from srsinv.grid import Open, Periodic
from tests.forward.setups import full_sensor, largest_error
from tests.tiers import rare

LINES = {"periodic": Periodic, "open": Open}


def run(kind):
    """Traction, operators, signals, noise spectrum and noise, everything built anew."""
    line, scan = LINES[kind](64, 1e-4, -3e-3), ConstantSpeed(0.05)
    scene = TractionScene(
        100.0,
        0.5,
        [PressedStrip(2e3, 1.5e-3, 0.3e-3, 0.2e-3), Sinusoid(50.0, 0.9e-3)],
        [FrictionStep(0.2, -0.4e-3, 0.3e-3)],
    )
    noises = (White(1e-6), SignalToNoise(40.0), Johnson(), Sliding())

    @jax.jit
    def all_of_it():
        r = scene.traction(line, scan.direction)
        operator = line.operator(full_sensor(CurrentAmplifier(1e6)).output(scan))
        signal = operator(r)
        integrated = line.operator(full_sensor(IntegratedCurrent(1e6)).output(scan))(r)
        spectrum = total_spectrum(noises, line, scan, jnp.sqrt(jnp.mean(signal**2)))
        noise = draw(jax.random.key(0), spectrum, 3, 64)
        return {
            "traction": r,
            "transfer": operator.transfer,
            "signal": signal,
            "integrated": integrated,
            "adjoint": operator.adjoint(signal),
            "spectrum": spectrum,
            "noise": noise,
        }

    return jax.device_get(all_of_it())


@pytest.mark.full
@pytest.mark.parametrize("kind", rare(LINES, "periodic"))
def test_single_precision(kind):
    double = run(kind)
    with jax.enable_x64(False):
        single = run(kind)
    wide = {name: value.dtype.name for name, value in double.items()}
    narrow = {name: value.dtype.name for name, value in single.items()}
    assert {*wide.values()} == {"float64", "complex128"}
    assert {*narrow.values()} == {"float32", "complex64"}
    # Other random bits make other noise; the rest agrees.
    for name in ("traction", "signal", "integrated", "adjoint", "spectrum"):
        assert largest_error(single[name], double[name]) < 64 * np.finfo(np.float32).eps, name
