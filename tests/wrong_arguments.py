"""Arguments of the wrong kind, given to the public functions by a program of its own, and parts
whose methods give what their kind does not: the tests' own checks of types would come first. Prints
each sentence that refuses one."""

import json
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np

import srsinv
from srsinv import kinds
from srsinv.effects import add_effects
from srsinv.forward.feature import POSITION, Axis, StripFeature
from srsinv.inverse.line.rule import Choice
from srsinv.inverse.nonlinear import Minimum

EXAMPLE = srsinv.examples.path("strip_two_element")
LINE, SCAN = srsinv.Periodic(128, cell_m=1.5e-4, start_m=-9.6e-3), srsinv.ConstantSpeed()
SCENE = srsinv.TractionScene()
ARRAYS = {"signal": np.zeros((2, 9)), "noise": 1e-8}
MOTION = srsinv.Motion.from_speed(np.arange(9) / 100, 0.05)
NO_START = Axis(POSITION.default, lambda within, stretch: np.zeros(0))


class Constant(kinds.Noise):
    power: object

    def spectrum(self, line, scan, signal_rms):
        return self.power


class Poles(kinds.Filter):
    given: tuple
    time_scale_s = 1e-4

    @property
    def poles(self):
        return self.given


class Gain(kinds.Amplifier):
    order: float
    given: object
    unit, offset = "V", 0.0

    def gain(self, speed_m_per_s):
        return self.given


class Thin(kinds.HalfSpace):
    def transfer(self, k, depth_m):
        return super().transfer(k, depth_m)[:3]


class Nothing(kinds.Effect):
    def apply(self, scenario):
        return None


class OutOfBox(kinds.Rule):
    name = "beyond"

    def choose(self, scorer, box):
        return Choice(box[1] + 1, "converged")


class Elsewhere(kinds.Solver):
    name = "elsewhere"
    tolerance, max_steps = None, 1

    def __call__(self, residual, z0, lower, upper):
        cost = jnp.sum(residual(z0) ** 2) / 2
        return Minimum(jnp.zeros(9), cost, cost, jnp.array(1), jnp.array(True))


class NoProfile(kinds.Feature):
    axes = MappingProxyType({"position_m": POSITION})

    def profile(self, shape):
        return shape["position_m"]


class Nowhere(kinds.Feature):
    axes = MappingProxyType({"position_m": NO_START})

    def profile(self, shape):
        return None


def simulated(noises=(), **parts):
    return srsinv.simulate(srsinv.Scenario(SCENE, srsinv.Sensor(**parts), SCAN, noises), LINE)


ZERO = np.zeros((2, 128))
WRONG = {
    r"Constant.spectrum gives 1.0: give the power .* \(65,\)": lambda: simulated([Constant(1.0)]),
    "noise .Constant. has the power -1.0 at the wavenumber 0": lambda: simulated(
        [Constant(-jnp.ones(65))]
    ),
    "Poles.poles is .*0.8j.*: give": lambda: simulated(filters=[Poles((-0.6 + 0.8j,))]),
    r"Poles.poles is \(-2.0,\): give": lambda: simulated(filters=[Poles((-2.0,))]),
    "Gain.order is 1.5: give 0": lambda: simulated(amplifier=Gain(1.5, jnp.ones(()))),
    "Gain.gain gives null for speeds of": lambda: simulated(amplifier=Gain(1, None)),
    "rms is nan: one of HalfSpace, Film, Film, Gain or": lambda: simulated(
        amplifier=Gain(1, jnp.array(np.nan))
    ),
    r"Thin.transfer gives .* of the shape \(4, 2, 257\)": lambda: simulated(skin=Thin()),
    "what effects.it makes is null: give the scenario": lambda: add_effects(
        srsinv.Scenario(SCENE, srsinv.Sensor(), SCAN), {"it": Nothing()}
    ),
    "OutOfBox.choose gives the log10 weights .*: give one for each": lambda: srsinv.Tikhonov(
        rule=OutOfBox()
    )(problem()),
    "what Elsewhere gives has a point of the shape": lambda: srsinv.FeatureFit(
        {"it": StripFeature()}, Elsewhere()
    )(samples()),
    "solver is 5: give a solver": lambda: srsinv.FeatureFit({"it": StripFeature()}, 5),
    "nominal_sensor is 5: give a known sensor": lambda: srsinv.FeatureFit(
        {"it": StripFeature()}, nominal_sensor=5
    ),
    "what NoProfile.profile gives is .*: give a pressure": lambda: srsinv.FeatureFit(
        {"it": NoProfile()}
    )(samples()),
    r"Nowhere.axes\['position_m'\] tries array": lambda: srsinv.FeatureFit({"it": Nowhere()})(
        samples()
    ),
    "stderr has negative or infinite": lambda: long_problem().estimate(ZERO, ZERO - 1),
    "resolved_dof is nan": lambda: long_problem().estimate(ZERO, resolved_dof=np.nan),
    "warnings is 'one': give a list": lambda: long_problem().estimate(ZERO, warnings="one"),
    "status is 'fine': give one of converged": lambda: long_problem().estimate(ZERO, status="fine"),
    "stats has mine = .*: give a number": lambda: long_problem().estimate(ZERO, mine=(1, 2)),
    "the nearest is strip_two_element": lambda: srsinv.examples.path("strip_two_elements"),
    "5 cannot be drawn: give an estimate": lambda: srsinv.plot.answer(5),
    r"truth has the shape \(3,\)": lambda: srsinv.plot.estimates(
        long_problem().estimate(ZERO), truth=np.zeros(3)
    ),
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


def samples():
    """Of nothing but noise."""
    signal = np.random.default_rng(0).normal(size=(2, 9))
    return srsinv.Problem(srsinv.Sensor(), MOTION, signal, 1.0)


def problem():
    """On cells of the samples' own."""
    return samples().to_grid()


def long_problem():
    """On the cells of a line."""
    return simulated([Constant(jnp.ones(65))]).problem


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
