"""Arguments of the wrong kind, given to the public functions by a program of its own: the tests'
own checks of types would come first. Prints each sentence that refuses one."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import srsinv
from srsinv.forward.feature import StripFeature

EXAMPLE = Path(srsinv.__file__).parent / "examples" / "strip_two_element.csv"
LINE, SCAN = srsinv.Periodic(128, cell_m=1.5e-4, start_m=-9.6e-3), srsinv.ConstantSpeed()
SCENE = srsinv.TractionScene()
ARRAYS = {"signal": np.zeros((2, 9)), "noise": 1e-8}
MOTION = srsinv.Motion.from_speed(np.arange(9) / 100, 0.05)
WRONG = {
    "method is 'wiener': give a method": lambda: srsinv.invert(EXAMPLE, "wiener"),
    "feature 'a' is 'strip'": lambda: srsinv.fit_recording(EXAMPLE, {"a": "strip"}),
    "features is .*: give a mapping": lambda: srsinv.fit_recording(EXAMPLE, [StripFeature()]),
    "skin is 'rubber'": lambda: srsinv.Sensor(skin="rubber"),
    r"elements\[0\] is 1: give one of films": lambda: srsinv.Sensor([1, 2]),
    r"elements is Film\(.*: give a list of films": lambda: srsinv.Sensor(srsinv.Film()),
    "sensor is 'film': give a Sensor": lambda: srsinv.Scenario(SCENE, "film", SCAN),
    "scene is 5: give a TractionScene or": lambda: srsinv.Scenario(5, srsinv.Sensor(), SCAN),
    "noises is 40: give a list of noises": lambda: srsinv.Scenario(
        SCENE, srsinv.Sensor(), SCAN, 40
    ),
    r"pressures\[0\] is 'strip': give one of": lambda: srsinv.TractionScene(pressures=["strip"]),
    r"surfaces is \{'ridge'.*: give a list": lambda: srsinv.SurfaceScene(1e4, {"ridge": 1}),
    "scenario is 'ridge': give a Scenario": lambda: srsinv.simulate("ridge", LINE),
    "line is 256: give a line": lambda: srsinv.simulate(
        srsinv.Scenario(SCENE, srsinv.Sensor(), SCAN), 256
    ),
    "line is 5: give a line": lambda: srsinv.Wiener()(problem()).on(5),
    "sensor is null": lambda: srsinv.Problem(None, MOTION, **ARRAYS),
    "motion is .*: give a Motion": lambda: srsinv.Problem(srsinv.Sensor(), SCAN, **ARRAYS),
    "no array of numbers": lambda: srsinv.Problem(srsinv.Sensor(), MOTION, "abc", 1.0),
    "has 18 infinite samples": lambda: srsinv.Problem(
        srsinv.Sensor(), MOTION, np.full((2, 9), np.inf), 1.0
    ),
    "nominal_pressure_Pa is nan": lambda: srsinv.Problem(
        srsinv.Sensor(), MOTION, **ARRAYS, nominal_pressure_Pa=np.nan
    ),
    r"window_m is \(1, 0\)": lambda: srsinv.Problem(
        srsinv.Sensor(), MOTION, **ARRAYS, window_m=(1, 0)
    ),
    "outside jax.jit": lambda: jax.jit(
        lambda y: srsinv.Problem(srsinv.Sensor(), MOTION, y, 1.0).data
    )(ARRAYS["signal"]),
    r"shape \(2, 63\): give \(component, cell\).* \(2, 128\)": lambda: srsinv.Sensor().operator(
        LINE, SCAN
    )(jnp.zeros((2, 63))),
    r"The traction has the shape \(2, 5\)": lambda: problem().estimate(np.zeros((2, 5))),
}


def problem():
    """Of nothing but noise."""
    signal = np.random.default_rng(0).normal(size=(2, 9))
    return srsinv.Problem(srsinv.Sensor(), MOTION, signal, 1.0).on_line()


if __name__ == "__main__":
    said = {}
    for sentence, call in WRONG.items():
        try:
            said[sentence] = repr(call())
        except srsinv.BadInput as refusal:
            said[sentence] = str(refusal)
        except Exception as fault:  # which is what must not be
            said[sentence] = f"{type(fault).__name__}: {fault}"
    print(json.dumps(said))
