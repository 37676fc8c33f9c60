"""srsinv: forward and inverse model of stress-rate tactile sensors.

`dir(srsinv)` lists what is public here; the bases of parts of your own are in `srsinv.kinds`. SI
units everywhere. Invalid input raises [`BadInput`][].

Double precision is the default: stress decays as exp(-kz), so an inversion loses digits quickly.
The variable is set before jax is imported, so that `import srsinv` itself stays quick; a value that
the user has set in JAX_ENABLE_X64 is left as it is.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

# `python -m srsinv` puts the current folder first on the import path, where a file named as one of
# the standard library's modules would be run in its place. Only then is the first argument "-m".
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    del sys.path[0]

if "JAX_ENABLE_X64" not in os.environ:
    os.environ["JAX_ENABLE_X64"] = "true"
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)

if TYPE_CHECKING:  # for editors and type checkers, which cannot read the table below
    from . import examples as examples
    from . import kinds as kinds
    from . import plot as plot
    from .api import fit_recording as fit_recording
    from .api import invert as invert
    from .api import simulate as simulate
    from .errors import BadInput as BadInput
    from .forward.feature import StripFeature as StripFeature
    from .forward.film import Film as Film
    from .forward.noise import SignalToNoise as SignalToNoise
    from .forward.scan import ConstantSpeed as ConstantSpeed
    from .forward.scan import Motion as Motion
    from .forward.scenario import Scenario as Scenario
    from .forward.scene import SurfaceScene as SurfaceScene
    from .forward.scene import TractionScene as TractionScene
    from .forward.sensor import Sensor as Sensor
    from .forward.surface_feature import RidgeFeature as RidgeFeature
    from .forward.surface_feature import TapeFeature as TapeFeature
    from .forward.traction import UniformStrip as UniformStrip
    from .grid import Line as Line
    from .grid import Open as Open
    from .grid import Periodic as Periodic
    from .inverse.bursts.estimate import BurstEstimate as BurstEstimate
    from .inverse.bursts.method import BurstInversion as BurstInversion
    from .inverse.conformal import Conformal as Conformal
    from .inverse.estimate import Estimate as Estimate
    from .inverse.estimate import relative_error as relative_error
    from .inverse.features.estimate import FeatureEstimate as FeatureEstimate
    from .inverse.features.method import FeatureFit as FeatureFit
    from .inverse.line.constraint import Admissible as Admissible
    from .inverse.line.constraint import Edges as Edges
    from .inverse.line.problem import LineProblem as LineProblem
    from .inverse.line.rule import Evidence as Evidence
    from .inverse.linear.estimate import LinearEstimate as LinearEstimate
    from .inverse.linear.prior import GaussianPrior as GaussianPrior
    from .inverse.linear.problem import LinearProblem as LinearProblem
    from .inverse.live.live import Live as Live
    from .inverse.live.live import LiveCells as LiveCells
    from .inverse.nonlinear import Fit as Fit
    from .inverse.nonlinear import PosteriorSamples as PosteriorSamples
    from .inverse.nonlinear import fit as fit
    from .inverse.nonlinear import fit_many as fit_many
    from .inverse.nonlinear import sample as sample
    from .inverse.problem import Problem as Problem
    from .inverse.semi_blind import SemiBlind as SemiBlind
    from .inverse.tikhonov import Tikhonov as Tikhonov
    from .inverse.wiener import Wiener as Wiener
    from .recording import Recording as Recording
    from .recording import load as load

__version__ = "0.1.0"

# The module of each public name, imported when the name is asked for: most import jax, which takes
# a second.
_MODULES = {
    "Admissible": "inverse.line.constraint",
    "BadInput": "errors",
    "BurstEstimate": "inverse.bursts.estimate",
    "BurstInversion": "inverse.bursts.method",
    "Conformal": "inverse.conformal",
    "ConstantSpeed": "forward.scan",
    "Edges": "inverse.line.constraint",
    "Estimate": "inverse.estimate",
    "Evidence": "inverse.line.rule",
    "FeatureEstimate": "inverse.features.estimate",
    "FeatureFit": "inverse.features.method",
    "Film": "forward.film",
    "Fit": "inverse.nonlinear",
    "GaussianPrior": "inverse.linear.prior",
    "Line": "grid",
    "LineProblem": "inverse.line.problem",
    "LinearEstimate": "inverse.linear.estimate",
    "LinearProblem": "inverse.linear.problem",
    "Live": "inverse.live.live",
    "LiveCells": "inverse.live.live",
    "Motion": "forward.scan",
    "Open": "grid",
    "Periodic": "grid",
    "PosteriorSamples": "inverse.nonlinear",
    "Problem": "inverse.problem",
    "Recording": "recording",
    "RidgeFeature": "forward.surface_feature",
    "Scenario": "forward.scenario",
    "SemiBlind": "inverse.semi_blind",
    "Sensor": "forward.sensor",
    "SignalToNoise": "forward.noise",
    "StripFeature": "forward.feature",
    "SurfaceScene": "forward.scene",
    "TapeFeature": "forward.surface_feature",
    "Tikhonov": "inverse.tikhonov",
    "TractionScene": "forward.scene",
    "UniformStrip": "forward.traction",
    "Wiener": "inverse.wiener",
    "examples": "examples",
    "fit": "inverse.nonlinear",
    "fit_many": "inverse.nonlinear",
    "fit_recording": "api",
    "invert": "api",
    "kinds": "kinds",
    "load": "recording",
    "plot": "plot",
    "relative_error": "inverse.estimate",
    "sample": "inverse.nonlinear",
    "simulate": "api",
}
__all__ = list(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module = importlib.import_module(f"{__name__}.{_MODULES[name]}")
        is_module = name == _MODULES[name].rpartition(".")[2]
        return module if is_module else getattr(module, name)


def __dir__() -> list[str]:
    return list(__all__)
